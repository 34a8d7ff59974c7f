"""Compiled programs, kept in the user's cache folder: a new process loads one in place of tracing and compiling it.

Loading a program runs code, so the folder is the user's alone. An entry is written whole or not at all, and checked by
a sum; whatever is wrong with one, or with the folder, costs a compilation and nothing else (docs/compiler.md).
"""

import contextlib
import functools
import hashlib
import inspect
import io
import operator
import os
import pickle
import re
import stat
import sys
import tempfile
import threading
import time
import weakref
from collections.abc import Callable, Hashable, Iterator
from pathlib import Path
from typing import Any, Generic, Literal, NamedTuple, ParamSpec, TypeVar, cast

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jax.experimental import serialize_executable
from jax.extend.core import find_top_trace

from .identity import NO_MATTER, VARIABLE, Unidentified, kind_of_leaf, options_now, this_machine, walked

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

    Under a transformation of JAX other than `vmap` alone, whose batches are programs as well, and wherever a program
    cannot be identified surely, it is ``jax.jit`` itself.
    `filtered`: what is no array in the arguments is static, as in ``equinox.filter_jit``.
    """

    def __init__(
        self, function: Callable[_Arguments, _Result], static: frozenset[str], filtered: bool, options: dict[str, Any]
    ):
        functools.update_wrapper(self, function)
        self.function, self.static, self.filtered, self.options = function, static, filtered, options
        self.signature = inspect.signature(function)
        compiled: Any = (
            eqx.filter_jit(function) if filtered else jax.jit(function, static_argnames=sorted(static), **options)
        )
        self.usual = compiled
        self.programs: dict[Hashable, Any] = {}
        self.lock, self.generation = threading.RLock(), -1
        _all.add(self)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.usual, name)  # trace, lower, eval_shape

    def __call__(self, *args: _Arguments.args, **named: _Arguments.kwargs) -> _Result:
        under = _transformation()
        if under == "another" or any(_not_with(jax.config)):
            return self.usual(*args, **named)
        given = self.signature.bind(*args, **named).arguments
        static = {name: given[name] for name in given if name in self.static}
        traced = {name: given[name] for name in given if name not in self.static}
        if self.filtered:
            traced, static = eqx.partition(traced, eqx.is_array)
        leaves, tree = jax.tree.flatten(traced)
        static_leaves, static_tree = jax.tree.flatten(static)
        what = tree, static_tree, (*static_leaves,), (*map(type, static_leaves),)
        try:
            if under == "vmap" and any(isinstance(leaf, Tracer) for leaf in leaves):
                return self._of_batch(what, leaves, tree, static)
            # The type of an array that JAX keeps with it costs a tenth of asking the array (`kind_of_leaf`).
            kinds = tuple([leaf.aval if type(leaf).__name__ == "ArrayImpl" else kind_of_leaf(leaf) for leaf in leaves])
            key = *what, kinds, _state(jax.config)
            known = self._known(key)
        except (Unidentified, TypeError):  # traced numbers; what has no hash
            return self.usual(*args, **named)
        program = self._found(key, leaves, tree, static) if known is _UNKNOWN else known
        if program is None:
            return self.usual(*args, **named)
        return cast(_Result, jax.tree.unflatten(program.result, program.call(*leaves)))

    def bound(self, arrays: tuple[Any, ...], static: dict[str, Any]) -> Callable[..., Any]:
        """The function, for arrays like these and with these static arguments, outside of transformations.

        What the arrays are is not looked at again: while Python does so, other threads wait.
        """
        if any(_not_with(jax.config)):
            return functools.partial(self.usual, **static)
        leaves, tree = jax.tree.flatten(dict(zip(self.signature.parameters, arrays, strict=False)))
        static_leaves, static_tree = jax.tree.flatten(static)
        kinds = tuple(leaf.aval for leaf in leaves)
        key = tree, static_tree, (*static_leaves,), (*map(type, static_leaves),), kinds, _state(jax.config)
        program = self._found(key, leaves, tree, static)
        if program is None:
            return functools.partial(self.usual, **static)
        return lambda *arrays: jax.tree.unflatten(program.result, program.call(*jax.tree.leaves(arrays)))

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
            about = (this_machine(), options_now(), self.function, self.filtered, self.options, static)
            walk = walked(about, jax.tree.unflatten(tree, leaves))
        except Exception:  # `Unidentified`, or what objects of users do when they are looked at
            return None
        path, objects = folder / walk.sum.hexdigest(), [seen for _, seen in walk.seen.values()]
        if (found := _read(path, len(leaves), objects)) is not None:
            return found
        of_leaves, structure = _function_of_leaves(self.function, self.filtered, tree, static), None

        def listed(*leaves: Any) -> list[Any]:
            nonlocal structure
            found, structure = jax.tree.flatten(of_leaves(*leaves))
            return found

        # JAX's own cache, where the user has it on, knows programs by this name too. Another version of the package
        # must not find there what cannot be written again (`_hits`).
        listed.__name__ = f"{self.function.__name__}_{path.name[:8]}"
        with _telling_that_it_compiles():
            lowered, before = jax.jit(listed, **self.options).lower(*leaves), _hits()
            compiled = lowered.compile()
        calls = set(re.findall(r"custom_call @(\w+)", lowered.as_text()))
        # What JAX has from its own cache lacks functions when it is written again. Functions outside of the program,
        # but those that every process has, may not be there where it is loaded: to call them would end the process.
        if _hits() == before and all(name.startswith(_EVERYWHERE) for name in calls):
            _write(path, compiled, structure, objects, any(name.startswith(_LAPACK) for name in calls))
        return _Program(compiled, structure)

    def _of_batch(self, what: tuple[Any, ...], leaves: list[Any], tree: Any, static: Any) -> Any:
        """The results for a batch under ``jax.vmap``, by a program for all of it."""
        results: list[Any] = []

        # The rule of a function under vmap is handed the whole batch, and called where there is no vmap any more.
        @jax.custom_batching.custom_vmap
        def look(leaves: list[Any]) -> Any:
            return np.float32(0)

        @look.def_vmap
        def _(size: int, is_mapped: list[list[bool]], leaves: list[Any]) -> Any:
            key = *what, "batch", *is_mapped[0]
            if (batch := self._known(key)) is _UNKNOWN:
                of_leaves = _function_of_leaves(self.function, self.filtered, tree, static)
                axes = tuple(0 if mapped else None for mapped in is_mapped[0])
                function = jax.vmap(of_leaves, in_axes=axes)
                batch = self.programs[key] = KeptJit(function, frozenset(), False, self.options)
            results.append(batch(*leaves))
            return np.zeros(size, np.float32), True

        token = look(leaves)
        found, structure = jax.tree.flatten(results[0])

        @jax.custom_batching.custom_vmap
        def put(token: Any) -> list[Any]:
            return [np.broadcast_to(np.zeros((), leaf.dtype), leaf.shape[1:]) for leaf in found]

        @put.def_vmap
        def _(size: int, is_mapped: list[bool], token: Any) -> Any:
            return found, [True] * len(found)

        return jax.tree.unflatten(structure, put(token))


def _function_of_leaves(function: Callable[..., Any], filtered: bool, tree: Any, static: Any) -> Callable[..., Any]:
    """`function` of the leaves of what is traced, its static arguments given."""

    def of_leaves(*leaves: Any) -> Any:
        traced = jax.tree.unflatten(tree, leaves)
        given = eqx.combine(traced, static) if filtered else {**traced, **static}
        return _called(function, given)

    return of_leaves


def _called(function: Callable[..., Any], given: dict[str, Any]) -> Any:
    bound = inspect.signature(function).bind_partial()
    bound.arguments.update((name, given[name]) for name in bound.signature.parameters if name in given)
    return function(*bound.args, **bound.kwargs)


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
    return _transformation() is not None


def _transformation() -> Literal["vmap", "another"] | None:
    """What JAX does with the code that calls this: "vmap" where nothing else is done."""
    trace, found = find_top_trace(()), None
    while type(trace).__name__ == "BatchTrace":
        trace, found = trace.parent_trace, "vmap"
    return found if type(trace).__name__ == "EvalTrace" else "another"


def plain_numpy() -> Any:
    """NumPy, whose operations are not compiled, where JAX traces nothing; else ``jax.numpy``."""
    return jnp if is_compiling() else np


_state = operator.attrgetter(
    *(k for k in jax.config.values if hasattr(jax.config, k) and not any(word in k for word in NO_MATTER))
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
