"""What identifies a compiled program without tracing it: a check sum of all that its tracing can read.

A wrong answer would run another program than the user's, so nothing is left to chance. Code of users is followed into
everything that it refers to: globals, closures, defaults, superclasses, instances, the modules of the user. Code of
packages is known by its name there and their versions. What may change in a way that is not seen here is
`Unidentified`: such a program is traced as always.
"""

import builtins
import contextlib
import dataclasses
import dis
import enum
import functools
import hashlib
import os
import platform
import struct
import sys
import sysconfig
import types
from collections.abc import Callable, Iterable
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer

PACKAGES = frozenset((
    "diffrax", "equinox", "jax", "jaxlib", "jaxtyping", "lineax", "numpy", "optimistix", "scipy", "stickslip_jax",
))  # fmt: skip
"""Packages whose versions (of this one, whose source) are part of the key."""
_LIBRARY = frozenset((
    "__future__", "abc", "builtins", "cmath", "collections", "contextlib", "dataclasses", "enum", "fractions",
    "functools", "itertools", "math", "numbers", "operator", "types", "typing", "warnings",
))  # fmt: skip
"""Modules of the standard library that always do the same: none that looks at clocks, files or the environment."""
_FILES = frozenset(("load", "loads", "fromfile", "open", "tree_deserialise_leaves"))
"""Names with which packages read files; and all that begin with "read"."""
_READING = _FILES | frozenset((
    "random", "load", "loads", "loadtxt", "genfromtxt", "fromfile", "fromregex", "memmap", "open_memmap", "lib", "io",
    "datetime64", "testing", "ctypeslib", "f2py", "geterr", "geterrcall", "get_printoptions", "show_config",
))  # fmt: skip
"""Names with which NumPy and SciPy give what is not the same each time, or what is in a file."""
_BUILTINS = frozenset((
    "__build_class__", "__debug__", "__name__", "abs", "all", "any", "bool", "bytes", "callable", "classmethod",
    "complex", "dict", "divmod", "enumerate", "filter", "float", "format", "frozenset", "int", "isinstance",
    "issubclass", "iter", "len", "list", "map", "max", "min", "next", "object", "pow", "print", "property", "range",
    "repr", "reversed", "round", "set", "slice", "sorted", "staticmethod", "str", "sum", "super", "tuple", "type",
    "zip", "Ellipsis", "NotImplemented", "False", "True", "None",
))  # fmt: skip
"""Builtins that show nothing of the process: not globals, getattr, open, id, hash, eval and their like."""
_OF_NO_EFFECT = frozenset((
    "__dict__", "__weakref__", "__doc__", "__annotations__", "__annotate__", "__annotate_func__",
    "__annotations_cache__", "__module__", "__qualname__", "__abstractmethods__", "_abc_impl", "__firstlineno__",
    "__static_attributes__", "__dataclass_params__", "__dataclass_fields__", "__orig_bases__", "__parameters__",
    "__classcell__", "__slotnames__",
))  # fmt: skip
"""Entries of a class that its methods do not read. Fields, with their defaults and metadata, are followed."""
_FIELDS = "__dataclass_fields__"
_PLAIN = (type(None), type(...), type(NotImplemented), bool, int, str, bytes, complex, float, range)
_LEAF = (jax.Array, np.ndarray, np.generic, bool, int, float, complex)
_OF_PYTHON = sysconfig.get_paths()["stdlib"]
_LARGEST_ARRAY = 2**28  # bytes that are read for a check sum
_FROM_CLASS_STATEMENT = 1 << 9  # Py_TPFLAGS_HEAPTYPE


class Unidentified(Exception):
    """What may change without this being seen."""


def identity(*values: object, arguments: object = None) -> str:
    """A check sum of the `values`, and of the structure, shapes and types of `arguments`. Raises `Unidentified`.

    Of `arguments`, a tree of modules, the numbers in the leaves do not count, and static fields do, by value.
    """
    return walked(values, arguments).sum.hexdigest()


def _shown(value: object) -> str:
    """What `value` says of itself; not that of an object that says its address, which is another in each process."""
    text = repr(value)
    if " at 0x" in text:
        raise Unidentified(f"the object {text}")
    return text


def walked(values: Iterable[object], arguments: object) -> "Walk":
    walk = Walk()
    walk.all("values", values)
    walk.argument(arguments)
    return walk


class Walk:
    """A walk through all that a program can read; each object once, later by the number of its first visit."""

    def __init__(self):
        self.sum = hashlib.blake2b(digest_size=20)
        self.seen: dict[int, tuple[int, object]] = {}  # with the object, so that no other gets its id

    def say(self, *words: str | bytes) -> None:
        """Words with their lengths, so that no two sequences of words are the same."""
        for word in words:
            data = word.encode("utf-8", "surrogatepass") if isinstance(word, str) else word
            self.sum.update(struct.pack("<q", len(data)) + data)

    def all(self, word: str, values: Iterable[object]) -> None:
        listed = list(values)
        self.say(word, str(len(listed)))
        for value in listed:
            self.value(value)

    def argument(self, value: Any) -> None:
        """Arguments of a compiled function: arrays and numbers by what JAX traces of them."""
        kind = type(value)
        if isinstance(value, _LEAF):
            self.say("leaf", *map(str, kind_of_leaf(value)))
        elif value is None:
            self.say("None")
        elif isinstance(value, eqx.Module):
            self.value(kind)
            for field in dataclasses.fields(value):
                self.say(field.name, str(field.name in vars(value)))
                if field.name in vars(value):
                    read = self.value if field.metadata.get("static", False) else self.argument
                    read(vars(value)[field.name])
        elif kind in (tuple, list) or (isinstance(value, tuple) and hasattr(kind, "_fields")):
            self.value(kind)
            self.say(str(len(value)))
            for one in value:
                self.argument(one)
        elif kind is dict:
            self.say("dict", str(len(value)))
            for key in sorted(value):
                self.value(key)
                self.argument(value[key])
        elif isinstance(value, functools.partial):
            self.seen[id(value)] = len(self.seen), value
            self.all("partial", (kind, value.func))
            self.argument((value.args, value.keywords))
        else:
            raise Unidentified(f"a leaf of {kind}")

    def value(self, value: Any) -> None:
        """Anything that tracing can read, by its value."""
        kind = type(value)
        if kind in _PLAIN:
            self.say(kind.__name__, value.hex() if kind is float else value if kind is bytes else repr(value))
            return
        # These are in no circle by themselves; whether equal ones are one object is for Python and NumPy to choose.
        if not isinstance(value, (tuple, frozenset, types.CodeType, np.dtype)):
            if id(value) in self.seen:
                self.say("again", str(self.seen[id(value)][0]))
                return
            self.seen[id(value)] = len(self.seen), value
        if (name := _name_in_package(value)) is not None:
            self.say("named", name)
            return
        for kinds, parts in _PARTS:
            if kind in kinds:
                self.all(kind.__name__, parts(value))
                return
        read = next((read for kinds, read in _READERS if isinstance(value, kinds)), Walk._instance)
        read(self, value)

    def _array(self, value: Any) -> None:
        if isinstance(value, Tracer):
            raise Unidentified("a traced number")
        if isinstance(value, jax.Array) and jnp.issubdtype(value.dtype, jax.dtypes.prng_key):
            self.say("key", str(jax.random.key_impl(value)))
            value = jax.random.key_data(value)
        if isinstance(value, jax.Array):
            self.say("jax", str(value.weak_type))
        array = np.asarray(value)
        is_plain = type(value) is np.ndarray or isinstance(value, (np.generic, jax.Array))
        if not is_plain or array.dtype.hasobject or array.nbytes > _LARGEST_ARRAY:
            raise Unidentified(f"an array of {type(value)}")
        self.say("array", str(array.shape), repr(array.dtype), np.ascontiguousarray(array).tobytes())

    def _word(self, value: Any) -> None:
        self.say(type(value).__name__, repr(value))

    def _of_enum(self, value: enum.Enum) -> None:
        self.value(type(value))
        self.say(value.name)

    def _named_tuple(self, value: tuple[Any, ...]) -> None:
        self.value(type(value))
        self.all("tuple", value)

    def _set(self, value: Iterable[object]) -> None:
        self.say(type(value).__name__, *sorted(identity(one) for one in value))

    def _class(self, kind: type) -> None:
        self.say("class", kind.__module__, kind.__qualname__)
        if not kind.__flags__ & _FROM_CLASS_STATEMENT:  # its methods are no code of Python
            if kind.__module__ != "builtins":
                raise Unidentified(f"the class {kind}")
            return  # NoneType, mappingproxy: not under these names in `builtins`
        self.all("bases", (type(kind), *kind.__bases__))
        entries = vars(kind)
        for name in sorted(set(entries) - _OF_NO_EFFECT):
            self.say(name)
            self.value(entries[name])
        # Those of its bases are followed there.
        inherited = {id(field) for base in kind.__mro__[1:] for field in vars(base).get(_FIELDS, {}).values()}
        for field in (one for one in entries.get(_FIELDS, {}).values() if id(one) not in inherited):
            # `kw_only` of a class variable is no truth value, but an object.
            are = field.init is True, field.kw_only is True, str(field._field_type)
            self.say("field", field.name, _shown(field.type), str(are))
            defaults = (field.default, field.default_factory)
            given = ["no default" if one is dataclasses.MISSING else one for one in defaults]
            self.all("of field", (field.metadata, *given))

    def _function(self, function: types.FunctionType) -> None:
        self.say("function", function.__module__ or "", function.__qualname__)
        self._code(function.__code__)
        self.all("defaults", (function.__defaults__, function.__kwdefaults__, function.__dict__))
        cells = []
        for cell in function.__closure__ or ():
            try:
                cells.append(cell.cell_contents)
            except ValueError:  # not filled yet
                cells.append("an empty cell")
        self.all("closure", cells)
        every, loaded, imported = _names(function.__code__)
        for name in sorted(loaded):
            self.say(name)
            if name in function.__globals__:
                self._global(function.__globals__[name], every)
            elif name not in _BUILTINS and not _is_exception(name):
                raise Unidentified(f"the name {name}")
        for name in sorted(imported):
            self._global(sys.modules.get(name), every)

    def _global(self, value: object, names: frozenset[str]) -> None:
        """What a function with these `names` can see of a global: of a module of the user, what has one of them."""
        if not isinstance(value, types.ModuleType):
            self.value(value)
            return
        top = value.__name__.split(".")[0]
        self.say("module", value.__name__)
        if _is_known(top):
            _refuse_reading(top, names)
            return
        if top in sys.stdlib_module_names:
            raise Unidentified(f"the module {value.__name__}")
        held = vars(value)
        for name in sorted(names & held.keys()):
            self.say(name)
            if not isinstance(held[name], types.ModuleType):
                self.value(held[name])
            elif id(held[name]) not in self.seen:
                self.seen[id(held[name])] = len(self.seen), held[name]
                self._global(held[name], names)

    def _code(self, code: types.CodeType) -> None:
        self.say(
            "code", code.co_code, *code.co_names, "", *code.co_varnames, "", *code.co_freevars, "", *code.co_cellvars
        )
        self.say(str((code.co_argcount, code.co_kwonlyargcount, code.co_posonlyargcount, code.co_flags)))
        self.say(getattr(code, "co_exceptiontable", b""))
        self.all("constants", code.co_consts)

    def _jitted(self, value: Any) -> None:
        info = value._jit_info
        options = (info.compiler_options_kvs, info.in_shardings_leaves, info.out_shardings_leaves)
        names = sorted(info.static_argnames)  # they may come from a set, which has another order in each process
        self.all("jit", (value.__wrapped__, info.static_argnums, names, info.inline, _shown(options)))

    def _structure(self, tree: Any) -> None:
        """A tree definition of JAX: of what kind each node is, and what it says of itself."""
        children = tree.children()
        self.all("structure", (tree.node_data(), len(children), tree.num_leaves))
        for child in children:
            self._structure(child)

    def _instance(self, value: Any) -> None:
        kind = type(value)
        if kind is object:
            self.say("object")  # a mark: what it is compared with is told by the number of its visit
            return
        if not _shows_all(kind):
            raise Unidentified(f"an object of {kind}")
        self.value(kind)
        names = [name for one in kind.__mro__ for name in _slots(one)]
        held = {name: getattr(value, name) for name in names if hasattr(value, name)} | getattr(value, "__dict__", {})
        for name in sorted(held, key=str):
            self.say(str(name))
            self.value(held[name])


def _slots(kind: type) -> list[str]:
    """The names of the slots that a class adds."""
    slots = vars(kind).get("__slots__", ())
    named = [slots] if isinstance(slots, str) else list(slots)
    private = [name.startswith("__") and not name.endswith("__") for name in named]
    mangled = [f"_{kind.__name__.lstrip('_')}{name}" if own else name for name, own in zip(named, private, strict=True)]
    return [name for name in mangled if name not in ("__dict__", "__weakref__")]


def _shows_all(kind: type) -> bool:
    """Whether its objects are no larger than their slots and dict: classes of C hold what no code of Python shows."""
    pointer = struct.calcsize("P")
    while kind is not object:
        base = kind.__base__
        assert base is not None
        shown = len(_slots(kind)) + ("__dict__" in vars(kind)) + ("__weakref__" in vars(kind))
        added = kind.__basicsize__ - base.__basicsize__
        if kind.__itemsize__ or added > shown * pointer or not kind.__flags__ & _FROM_CLASS_STATEMENT:
            return False
        kind = base
    return True


_PARTS: tuple[tuple[tuple[type, ...], Callable[[Any], Iterable[object]]], ...] = (
    ((tuple, list), list),
    ((dict, types.MappingProxyType), lambda held: [one for item in held.items() for one in item]),
    ((types.MethodType,), lambda method: (method.__func__, method.__self__)),
    ((staticmethod, classmethod), lambda method: (method.__func__,)),
    ((property,), lambda one: (one.fget, one.fset)),
    ((slice,), lambda one: (one.start, one.stop, one.step)),
    ((functools.partial,), lambda one: (one.func, one.args, one.keywords)),
    ((types.MemberDescriptorType,), lambda slot: (slot.__name__,)),
)
_READERS: tuple[tuple[tuple[type, ...], Callable[[Walk, Any], None]], ...] = (
    ((np.ndarray, np.generic, jax.Array), Walk._array),
    ((np.dtype,), Walk._word),
    ((enum.Enum,), Walk._of_enum),
    ((type,), Walk._class),
    ((types.FunctionType,), Walk._function),
    ((types.CodeType,), Walk._code),
    ((set, frozenset), Walk._set),
    ((tuple,), Walk._named_tuple),
    ((type(jax.jit(len)),), Walk._jitted),
    ((jax.tree_util.PyTreeDef,), Walk._structure),
)


def kind_of_leaf(value: Any) -> tuple[Any, ...]:
    """What JAX traces of an array or number: shape, type, whether that is weak. Raises `Unidentified` for others."""
    if isinstance(value, Tracer) or not isinstance(value, _LEAF):
        raise Unidentified("a traced number, or none")
    if isinstance(value, jax.Array):
        return value.shape, value.dtype, value.weak_type
    if isinstance(value, (np.ndarray, np.generic)):
        return value.shape, value.dtype, False
    return (), type(value).__name__, True


def _is_known(top: str) -> bool:
    """Whether what is in this module is known by name: not in one of the user's own with a name of the library's."""
    if top in _LIBRARY:
        file = getattr(sys.modules.get(top), "__file__", None)
        return file is None or Path(file).is_relative_to(_OF_PYTHON)
    return top in PACKAGES


def _is_exception(name: str) -> bool:
    found = getattr(builtins, name, None)
    return isinstance(found, type) and issubclass(found, BaseException)


def _refuse_reading(top: str, names: Iterable[str]) -> None:
    reading = _READING if top in ("numpy", "scipy") else _FILES
    for name in names:
        if name in reading or name.startswith("read"):
            raise Unidentified(f"{top}.{name}")


def _name_in_package(value: Any) -> str | None:
    """The name of a function or class of a package, under which it is found there; None for anything else."""
    module, name = getattr(value, "__module__", None), getattr(value, "__qualname__", None)
    name = name if isinstance(name, str) else getattr(value, "__name__", None)
    module = "numpy" if isinstance(value, np.ufunc) else module
    if not isinstance(module, str) or not isinstance(name, str):
        return None
    top = module.split(".")[0]
    if not _is_known(top):
        return None
    found: Any = sys.modules.get(module)
    for part in name.split("."):
        found = getattr(found, part, None)
    if found is not value and getattr(found, "__wrapped__", None) is not value:
        return None
    _refuse_reading(top, (*module.split(".")[1:], *name.split(".")))
    return f"{module}:{name}:{found is value}"


@functools.lru_cache(1 << 12)
def _names(code: types.CodeType) -> tuple[frozenset[str], frozenset[str], frozenset[str]]:
    """All names in a function's code and in the functions in it; those taken from globals; those that it imports."""
    steps = list(dis.get_instructions(code))
    of_globals = ("LOAD_GLOBAL", "LOAD_NAME", "STORE_GLOBAL", "DELETE_GLOBAL")
    names = (
        frozenset(code.co_names),
        frozenset(step.argval for step in steps if step.opname in of_globals),
        frozenset(step.argval for step in steps if step.opname == "IMPORT_NAME"),
    )
    inner = [_names(one) for one in code.co_consts if isinstance(one, types.CodeType)]
    every, loaded, imported = (own.union(*of_inner) for own, *of_inner in zip(names, *inner, strict=True))
    return every, loaded, imported


# What all programs of a process depend on besides.


VARIABLE = "STICKSLIP_PROGRAMS"
"""The environment variable that turns it "off", or chooses the folder; "on" by default."""
NO_MATTER = ("cache", "log", "traceback", "dump", "pprint", "explain")
"""Parts of the names of JAX's options that say where and what is written, not what is computed."""
_VARIABLES = ("XLA_", "JAX_", "STICKSLIP_", "TF_", "NPROC", "OMP_", "LLVM_", "CUDA_", "EQX_")


@functools.cache
def this_machine() -> str:
    """The code of the package, the versions of the others, the processor, its threads and the devices."""
    versions = []
    for name in sorted(PACKAGES):
        with contextlib.suppress(PackageNotFoundError):
            versions.append((name, version(name)))
    source, root = hashlib.blake2b(digest_size=20), Path(__file__).parents[1]
    for path in sorted(root.rglob("*.py")):
        source.update(str(path.relative_to(root)).encode() + b"\0" + path.read_bytes() + b"\0")
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").splitlines()
        processor = sorted({line for line in lines if line.lower().startswith(("flags", "features", "model"))})
    except OSError:
        processor = [platform.processor()]
    threads = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    devices = [(one.id, one.device_kind, one.platform, one.client.platform_version) for one in jax.devices()]
    of_python = sys.version, sys.flags.optimize, platform.platform()
    return repr((versions, source.hexdigest(), of_python, processor, threads, devices))


def options_now() -> str:
    """The options of JAX, those of this thread, and the variables of the environment that compilers read."""
    settings = sorted((k, repr(v)) for k, v in jax.config.values.items() if not any(word in k for word in NO_MATTER))
    variables = sorted((k, v) for k, v in os.environ.items() if k.startswith(_VARIABLES) and k != VARIABLE)
    return repr((settings, variables))
