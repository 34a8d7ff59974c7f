"""Compiled programs, kept in the user's cache folder: a new process loads one in place of tracing and compiling it.

Loading a program runs code, so the folder is the user's alone. An entry is written whole or not at all, and checked by
a sum; whatever is wrong with one, or with the folder, costs a compilation and nothing else (docs/compiler.md).
"""

import builtins
import contextlib
import dataclasses
import dis
import enum
import functools
import hashlib
import inspect
import io
import operator
import os
import pickle
import platform
import re
import stat
import struct
import sys
import sysconfig
import tempfile
import threading
import time
import types
import weakref
from collections.abc import Callable, Hashable, Iterable, Iterator
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, Generic, NamedTuple, ParamSpec, TypeVar, cast

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jax.experimental import serialize_executable
from jax.extend.core import find_top_trace

# What identifies a program without tracing it: a check sum of all that its tracing can read.
#
# A wrong answer would run another program than the user's, so nothing is left to chance. Code of users is followed into
# everything that it refers to: globals, closures, defaults, superclasses, instances, the modules of the user. Code of
# packages is known by its name there and their versions. What may change in a way that is not seen here is
# `Unidentified`: such a program is traced as always.


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
    return _walked(values, arguments).sum.hexdigest()


def _shown(value: object) -> str:
    """What `value` says of itself; not that of an object that says its address, which is another in each process."""
    text = repr(value)
    if " at 0x" in text:
        raise Unidentified(f"the object {text}")
    return text


def _walked(values: Iterable[object], arguments: object) -> "_Walk":
    walk = _Walk()
    walk.all("values", values)
    walk.argument(arguments)
    return walk


class _Walk:
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
        # Tuples and code are in no circle by themselves; whether equal ones are one object is for Python to choose.
        if not isinstance(value, (tuple, frozenset, types.CodeType)):
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
        read = next((read for kinds, read in _READERS if isinstance(value, kinds)), _Walk._instance)
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
        self.all("jit", (value.__wrapped__, info.static_argnums, info.static_argnames, info.inline, _shown(options)))

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
_READERS: tuple[tuple[tuple[type, ...], Callable[[_Walk, Any], None]], ...] = (
    ((np.ndarray, np.generic, jax.Array), _Walk._array),
    ((np.dtype,), _Walk._word),
    ((enum.Enum,), _Walk._of_enum),
    ((type,), _Walk._class),
    ((types.FunctionType,), _Walk._function),
    ((types.CodeType,), _Walk._code),
    ((set, frozenset), _Walk._set),
    ((tuple,), _Walk._named_tuple),
    ((type(jax.jit(len)),), _Walk._jitted),
    ((jax.tree_util.PyTreeDef,), _Walk._structure),
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


_NO_MATTER = ("cache", "log", "traceback", "dump", "pprint", "explain")
"""Parts of the names of JAX's options that say where and what is written, not what is computed."""
_VARIABLES = ("XLA_", "JAX_", "STICKSLIP_", "TF_", "NPROC", "OMP_", "LLVM_", "CUDA_", "EQX_")


@functools.cache
def _this_machine() -> str:
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


def _options() -> str:
    """The options of JAX, those of this thread, and the variables of the environment that compilers read."""
    settings = sorted((k, repr(v)) for k, v in jax.config.values.items() if not any(word in k for word in _NO_MATTER))
    variables = sorted((k, v) for k, v in os.environ.items() if k.startswith(_VARIABLES) and k != VARIABLE)
    return repr((settings, variables))


# Programs and their folder.


VARIABLE = "STICKSLIP_PROGRAMS"
"""The environment variable that turns it "off", or chooses the folder; "on" by default."""
LARGEST = 2**30
"""Largest size of the folder, bytes; the least recently used programs are deleted first."""
_HALF = "half-"  # of files that are not whole yet; what a killed process left goes an hour later
_MOST_PROGRAMS = 256  # of one function in a process
_MOST_MAPS = 40_000  # of the memory maps of a process, of which Linux gives 65,530; a program takes 50 to 300
_LAPACK = "lapack_"
_EVERYWHERE = (_LAPACK, "cu", "hip")  # beginnings of the names of functions that jaxlib brings with it
_UNKNOWN = object()
_not_with = operator.attrgetter(
    "jax_disable_jit", "jax_debug_nans", "jax_debug_infs", "jax_check_tracer_leaks", "jax_enable_checks"
)
"""Options with which ``jax.jit`` does more than to compile and run."""

_Arguments = ParamSpec("_Arguments")
_Result = TypeVar("_Result")


class _Program(NamedTuple):
    """A compiled function of arrays, and the structure of its results."""

    call: Callable[..., Any]
    result: Any


class KeptJit(Generic[_Arguments, _Result]):
    """``jax.jit(function)`` whose programs are kept from process to process.

    Under a transformation of JAX, and wherever a program cannot be identified surely, it is ``jax.jit`` itself.
    `filtered`: what is no array in the arguments is static, as in ``equinox.filter_jit``.
    """

    def __init__(
        self, function: Callable[_Arguments, _Result], static: frozenset[str], filtered: bool, options: dict[str, Any]
    ):
        functools.update_wrapper(self, function)
        self.function, self.static, self.filtered, self.options = function, static, filtered, options
        self.signature = inspect.signature(function)
        compiled: Any = (
            eqx.filter_jit(function) if filtered else jax.jit(function, static_argnames=(*static,), **options)
        )
        self.usual = compiled
        self.programs: dict[Hashable, _Program | None] = {}
        self.lock, self.generation = threading.RLock(), -1
        _all.add(self)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.usual, name)  # trace, lower, eval_shape

    def __call__(self, *args: _Arguments.args, **named: _Arguments.kwargs) -> _Result:
        if is_compiling() or any(_not_with(jax.config)):
            return self.usual(*args, **named)
        given = self.signature.bind(*args, **named).arguments
        static = {name: given[name] for name in given if name in self.static}
        traced = {name: given[name] for name in given if name not in self.static}
        if self.filtered:
            traced, static = eqx.partition(traced, eqx.is_array)
        leaves, tree = jax.tree.flatten(traced)
        static_leaves, static_tree = jax.tree.flatten(static)
        try:
            # The type of an array that JAX keeps with it costs a tenth of asking the array (`kind_of_leaf`).
            kinds = tuple([leaf.aval if type(leaf).__name__ == "ArrayImpl" else kind_of_leaf(leaf) for leaf in leaves])
            key = tree, static_tree, (*static_leaves,), (*map(type, static_leaves),), kinds, _state(jax.config)
            known = self._known(key)
        except (Unidentified, TypeError):  # traced numbers; what has no hash
            return self.usual(*args, **named)
        program = self._found(key, leaves, tree, static) if known is _UNKNOWN else known
        if program is None:
            return self.usual(*args, **named)
        return cast(_Result, jax.tree.unflatten(program.result, program.call(*leaves)))

    def _known(self, key: Hashable) -> Any:
        generation = _this_generation()
        if self.generation != generation or len(self.programs) > _MOST_PROGRAMS:
            self.programs, self.generation = {}, generation
        return self.programs.get(key, _UNKNOWN)

    def _found(self, key: Hashable, leaves: list[Any], tree: Any, static: Any) -> _Program | None:
        """The program from the folder, or compiled and put there; None where that cannot be."""
        with self.lock:  # many threads may ask for it at once
            if (known := self._known(key)) is _UNKNOWN:
                _let_go_of_too_many()
                self.programs[key] = known = self._kept(leaves, tree, static)
            return known

    def _kept(self, leaves: list[Any], tree: Any, static: Any) -> _Program | None:
        folder = programs_folder()
        used = {device for leaf in leaves if isinstance(leaf, jax.Array) for device in leaf.devices()}
        if folder is None or len(used.union(jax.devices())) > 1:
            return None
        try:
            about = (_this_machine(), _options(), self.function, self.filtered, self.options, static)
            walk = _walked(about, jax.tree.unflatten(tree, leaves))
        except Exception:  # `Unidentified`, or what objects of users do when they are looked at
            return None
        path, objects = folder / walk.sum.hexdigest(), [seen for _, seen in walk.seen.values()]
        if (found := _read(path, len(leaves), objects)) is not None:
            return found
        structure = None

        def of_leaves(*leaves: Any) -> list[Any]:
            nonlocal structure
            traced = jax.tree.unflatten(tree, leaves)
            given = eqx.combine(traced, static) if self.filtered else {**traced, **static}
            bound = self.signature.bind_partial()
            bound.arguments.update((name, given[name]) for name in self.signature.parameters if name in given)
            results = self.function(*bound.args, **bound.kwargs)
            structure = jax.tree.structure(results)
            return jax.tree.leaves(results)

        # JAX's own cache, where the user has it on, knows programs by this name too. Another version of the package
        # must not find there what cannot be written again (`_hits`).
        of_leaves.__name__ = f"{self.function.__name__}_{path.name[:8]}"
        with _telling_that_it_compiles():
            lowered, before = jax.jit(of_leaves, **self.options).lower(*leaves), _hits()
            compiled = lowered.compile()
        calls = set(re.findall(r"custom_call @(\w+)", lowered.as_text()))
        # What JAX has from its own cache lacks functions when it is written again. Functions outside of the program,
        # but those that every process has, may not be there where it is loaded: to call them would end the process.
        if _hits() == before and all(name.startswith(_EVERYWHERE) for name in calls):
            _write(path, compiled, structure, objects, any(name.startswith(_LAPACK) for name in calls))
        return _Program(compiled, structure)


_all: weakref.WeakSet[KeptJit[Any, Any]] = weakref.WeakSet()


def _let_go_of_too_many() -> None:
    """Where there is hardly room for another program, let go of all that are here: XLA ends a process without maps."""
    with contextlib.suppress(OSError):  # only Linux says how many there are
        if Path("/proc/self/maps").read_bytes().count(b"\n") > _MOST_MAPS:
            for one in tuple(_all):
                one.programs = {}


def kept_jit(function: Any = None, *, static_argnames: Any = (), filtered: bool = False, **options: Any) -> Any:
    """``jax.jit``, or ``equinox.filter_jit``, with programs that are kept; a decorator with or without options."""
    if function is None:
        return functools.partial(kept_jit, static_argnames=static_argnames, filtered=filtered, **options)
    names = (static_argnames,) if isinstance(static_argnames, str) else static_argnames
    return KeptJit(function, frozenset(names), filtered, options)


def is_compiling() -> bool:
    """Whether JAX traces the code that calls this for a program: results are traced then, whatever the arguments."""
    return type(find_top_trace(())).__name__ != "EvalTrace"


def plain_numpy() -> Any:
    """NumPy, whose operations are not compiled, where JAX traces nothing; else ``jax.numpy``."""
    return jnp if is_compiling() else np


_state = operator.attrgetter(
    *(k for k in jax.config.values if hasattr(jax.config, k) and not any(word in k for word in _NO_MATTER))
)
"""The options of JAX that may change within a process, as they are in this thread."""
_generation = 0


@jax.jit
def _probe(x: Any) -> Any:
    return x


_traced = weakref.ref(_probe)  # but for the first time: what JAX has in its caches, and nobody else has


def _this_generation() -> int:
    """Another number after ``jax.clear_caches()``, which lets go the programs that are kept in memory too."""
    global _generation, _traced  # noqa: PLW0603 - as of the caches of JAX
    if _generation == 0 or _traced() is None:
        _traced = weakref.ref(_probe.trace(0.0).jaxpr)
        _generation += 1
    return _generation


_PATIENCE = 2.0  # s, until a line tells what is waited for
hears_compiling: Callable[[bool], object] | None = None
"""In a process that works for another one: what tells that one that a compilation begins (True), or has ended."""


@contextlib.contextmanager
def _telling_that_it_compiles() -> Iterator[None]:
    """A line on the terminal while the block takes long; it goes when that ends."""
    if hears_compiling is not None:
        hears_compiling(True)
        try:
            yield
        finally:
            hears_compiling(False)
        return
    if not sys.stderr.isatty():
        yield
        return
    over, begin = threading.Event(), time.monotonic()

    def tell() -> None:
        while not over.wait(_PATIENCE):
            sys.stderr.write(f"\rcompiling (once: programs are kept), {time.monotonic() - begin:.0f} s \033[K")
            sys.stderr.flush()

    teller = threading.Thread(target=tell, daemon=True)
    teller.start()
    try:
        yield
    finally:
        over.set()
        teller.join()
        if time.monotonic() - begin > _PATIENCE:
            sys.stderr.write("\r\033[K")
            sys.stderr.flush()


_of_thread = threading.local()


def _hits() -> int:
    """How many programs this thread has had from JAX's own persistent cache."""
    _listen()
    return getattr(_of_thread, "hits", 0)


@functools.cache
def _listen() -> None:
    def note(event: str, **_: Any) -> None:
        if event == "/jax/compilation_cache/cache_hits":
            _of_thread.hits = getattr(_of_thread, "hits", 0) + 1

    jax.monitoring.register_event_listener(note)


def programs_folder() -> Path | None:
    """Where programs are kept, made if it is missing; None where that is off, or is not the user's alone."""
    wanted = os.environ.get(VARIABLE) or "on"
    if wanted.lower() == "off":
        return None
    try:
        is_usual = wanted.lower() == "on"
        folder = _caches() / "stickslip_jax" / "programs" if is_usual else Path(wanted).expanduser()
        folder.mkdir(parents=True, exist_ok=True, mode=0o700)
        found = folder.stat()
    except (OSError, RuntimeError, ValueError):  # no home folder, no folder, or not a name of one
        return None
    is_own = not hasattr(os, "getuid") or (found.st_uid == os.getuid() and not stat.S_IMODE(found.st_mode) & 0o077)
    return folder if is_own else None


def _caches() -> Path:
    """The user's cache folder, by the conventions of the operating system."""
    if sys.platform == "win32" and (folder := os.environ.get("LOCALAPPDATA")):
        return Path(folder)
    if sys.platform == "darwin":
        return Path.home() / "Library" / "Caches"
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")


class _Pickler(pickle.Pickler):
    """What the arguments hold is named by the number of its visit: functions and classes may have no other name."""

    def __init__(self, file: io.BytesIO, objects: list[object]):
        super().__init__(file)
        self.numbers = {id(seen): number for number, seen in enumerate(objects)}

    def persistent_id(self, obj: object) -> int | None:
        return self.numbers.get(id(obj))


class _Unpickler(pickle.Unpickler):
    def __init__(self, file: io.BytesIO, objects: list[object]):
        super().__init__(file)
        self.objects = objects

    def persistent_load(self, pid: int) -> object:
        return self.objects[pid]


def _read(path: Path, inputs: int, objects: list[object]) -> _Program | None:
    try:
        data = path.read_bytes()
        if hashlib.sha256(data[32:]).digest() != data[:32]:
            return None
        os.utime(path)
        executable, kept, outputs, needs_lapack = _Unpickler(io.BytesIO(data[32:]), objects).load()
        if needs_lapack:
            _find_lapack()
        trees = jax.tree.structure(((0,) * inputs, {})), jax.tree.structure([0] * outputs)
        return _Program(serialize_executable.deserialize_and_load(executable, *trees), jax.tree.structure(kept))
    except Exception:  # no such entry, or whatever reading one brings about: it is compiled
        return None


@functools.cache
def _find_lapack() -> None:
    """Let JAX look for the functions of LAPACK, as it does where it compiles a call of one, and not before."""
    jax.jit(jax.lax.linalg.cholesky).lower(jax.ShapeDtypeStruct((1, 1), np.float32))


def _write(path: Path, compiled: Any, structure: Any, objects: list[object], needs_lapack: bool) -> None:
    try:
        program = compiled._executable.unsafe_call
        if program.has_host_callbacks or program.keepalive or program.ordered_effects or program.has_unordered_effects:
            return  # it calls functions of this process
        kept = jax.tree.unflatten(structure, range(structure.num_leaves))
        buffer = io.BytesIO()
        executable, _, _ = serialize_executable.serialize(compiled)
        _Pickler(buffer, objects).dump((executable, kept, structure.num_leaves, needs_lapack))
        data = buffer.getvalue()
        if jax.tree.structure(_Unpickler(io.BytesIO(data), objects).load()[1]) != structure:
            return
        with tempfile.NamedTemporaryFile(dir=path.parent, prefix=_HALF, delete=False) as file:
            file.write(hashlib.sha256(data).digest() + data)
        os.replace(file.name, path)
        _make_room(path.parent)
    except Exception:  # results that cannot be stored, a full disk: it is compiled again the next time
        return


def _make_room(folder: Path) -> None:
    """Remove the programs that were not used for the longest time, where all are larger than `LARGEST` together."""
    entries = []
    for entry in os.scandir(folder):
        with contextlib.suppress(OSError):  # another process removed it
            found = entry.stat()
            if entry.name.startswith(_HALF) and found.st_mtime < time.time() - 3600:
                os.unlink(entry.path)
            else:
                entries.append((found.st_mtime, found.st_size, entry.path))
    excess = sum(size for _, size, _ in entries) - LARGEST
    for _, size, path in sorted(entries) if excess > 0 else ():
        if excess > -LARGEST // 10:  # some more, so that not every program that is written looks for one to remove
            with contextlib.suppress(OSError):
                os.unlink(path)
            excess -= size
