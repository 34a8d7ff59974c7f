"""Programs of each kind, loaded by a process in which nothing else has run: the numbers of the one that compiled them.

A program may call functions that JAX only finds where it compiles such a call (LAPACK).
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jaxlib import lapack
from support.processes import in_processes

from stickslip_jax._compiler import programs as kept

BEGIN = """
import functools
import warnings
import jax
jax.config.update("jax_enable_x64", True)
import equinox as eqx
import jax.numpy as jnp
import numpy as np
import stickslip_jax as ss
from stickslip_jax import nonlinear
from stickslip_jax._compiler import programs as kept
compiled, write = [], kept._write
kept._write = lambda path, *rest: compiled.append(path.name) or write(path, *rest)
S = lambda friction=ss.Coulomb(0.5), stiffness=4.0, **more: ss.MassSpring(1.0, stiffness, 1.0, friction, **more)
H, TIMES, MANY = ss.Harmonic(1.0, 1.0), np.linspace(0.0, 5.0, 21), {"samples": 6, "key": jax.random.key(0)}
FIVE = {"t1": 5.0, "y0": (0.3, 0.0)}
class Own(ss.FrictionLaw):
    mu: float
    @property
    def static(self):
        return self.mu
    def kinetic(self, speed):
        return self.mu * (1 - 0.1 * jnp.tanh(speed))
class Hung(ss.SwitchedSystem):
    mu: float
    @property
    def state_names(self):
        return "position in m", "velocity in m/s"
    def rates(self, t, y, base, friction):
        return y[1], -4 * y[0] - self.mu * friction
    def relative_velocity(self, t, y, base):
        return y[1] - base.velocity
    @property
    def shortest_time(self):
        return 0.5
def curve(slope, speed):
    return 0.5 - slope * jnp.tanh(speed)
def watched(one):
    return one, one.evaluate(TIMES), one.peak(), repr(one)
def seen(one):
    return watched(one), one.energies(TIMES), one.friction_force(TIMES), one.slips
"""
END = """
for leaf in jax.tree.leaves(found):
    if eqx.is_array(leaf) and jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key):
        leaf = jax.random.key_data(leaf)
    print(np.asarray(leaf).tobytes().hex() if eqx.is_array_like(leaf) else type(leaf).__name__)
print(len(compiled))
"""
KINDS = {
    "one mass": "seen(ss.simulate(S(), ss.Constant(1.0), **FIVE))",
    "Stribeck friction": "seen(ss.simulate(S(ss.Stribeck(0.5, 1.0, 0.5)), H, **FIVE))",
    "a curve of one's own": "seen(ss.simulate(S(ss.FrictionCurve(lambda v: 0.5 - 0.1 * jnp.tanh(v))), H, **FIVE))",
    "a law of one's own": "seen(ss.simulate(S(Own(0.5)), H, **FIVE))",
    "a system of one's own": "watched(ss.simulate(Hung(0.5), H, **FIVE))",
    "an ensemble of one's own": "ss.simulate_ensemble(Hung(0.5), ss.RandomPhase(H), progress=False, **FIVE, **MANY)",
    "a law of one's own in an ensemble": "ss.simulate_ensemble(S(Own(0.5)), ss.RandomSteps(1.0, 1.0), keep='sticks', "
    "progress=False, **FIVE, **MANY)",
    "a sensitivity of one's own": "ss.sensitivity('stick_fraction', S(Own(0.5)), ss.RandomSteps(1.0, 1.0), wrt='mu', "
    "**FIVE, **MANY)",
    "a partial function": "seen(ss.simulate(S(ss.FrictionCurve(functools.partial(curve, 0.1))), H, **FIVE))",
    "a compiled function": "seen(ss.simulate(S(ss.FrictionCurve(jax.jit(lambda v: 0.5 - 0.1 * v))), H, **FIVE))",
    "a cart": "seen(ss.simulate(ss.MotorCart(0.3), ss.SourceVoltage(12.0), t1=1.0))",
    "three blocks": "watched(ss.simulate(ss.block_row(3, mass=1.0, between=4.0, to_ground=4.0, normal_force=1.0, "
    "friction=ss.Coulomb(0.5)), ss.Constant(1.0), t1=5.0))",
    "masses that hang together": "watched(ss.simulate(ss.LinearStructure([[2.0, 1.0], [1.0, 3.0]], [[4.0, -1.0], "
    "[-1.0, 3.0]], [[0.2, 0.1], [0.1, 0.3]], [ss.Contact([1.0, 0.0], 1.0, ss.Coulomb(0.3))]), H, t1=5.0))",
    "smoothed friction": "watched(ss.simulate(S(), H, method=ss.Regularized(1e-2), **FIVE))",
    "LuGre friction": "watched(ss.simulate(S(ss.LuGre(0.5, 0.6, 0.1, 1e2, 1.0)), H, method=ss.Regularized(), **FIVE))",
    "an ensemble": "(lambda many: (many, ss.stick_fraction(many)))(ss.simulate_ensemble(S(), "
    "ss.RandomSteps(1.0, 1.0), keep='sticks', progress=False, **FIVE, **MANY))",
    "an ensemble of records": "ss.simulate_ensemble(S(), ss.KanaiTajimi(rms=1.5), progress=False, **FIVE, **MANY)",
    "outputs": "ss.simulate_ensemble(S(stiffness=ss.Uniform(3.0, 5.0)), H, outputs={'peak': lambda one: one.peak()}, "
    "progress=False, **FIVE, **MANY)",
    "a batch": "jax.vmap(lambda v: ss.simulate(S(), H, t1=5.0, y0=(0.0, v)))(jnp.arange(3.0))",
    "a sensitivity": "ss.sensitivity('mean_stick_duration', S(), ss.RandomSteps(1.0, 1.0), wrt='mu', **FIVE, **MANY)",
    "a fit": "ss.calibrate(S(ss.Coulomb(0.4)), H, TIMES, {'position': ss.simulate(S(), H, **FIVE).evaluate(TIMES)[0]}, "
    "wrt=('mu', 'stiffness')).estimates",
    "an orbit": "nonlinear.periodic_orbit(S(), H, y0=(0.3, 0.1)).multipliers",
    "exponents": "nonlinear.lyapunov_exponents(S(), H, transient=5, kept=5, progress=False).exponent",
}


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_a_program_is_loaded_where_nothing_else_has_run(kind, tmp_path):
    code = f"{BEGIN}found = {KINDS[kind]}{END}"
    (first,), (second,) = (in_processes(1, code, tmp_path / "programs") for _ in range(2))
    *numbers, compiled = first.split()
    assert int(compiled) > 0
    assert second.split() == [*numbers, "0"]


IDENTITIES = """
from stickslip_jax._compiler.identity import identity
for law in (Own(0.5), ss.FrictionCurve(functools.partial(curve, 0.1)), ss.FrictionCurve(jax.jit(lambda v: 0.5))):
    print(identity(arguments=(S(law), H)))
def function(x, *, one, another, third):
    return x
print(identity(jax.jit(function, static_argnames={"one", "another", "third"})))
print(identity(kept.kept_jit(function, static_argnames=("one", "another", "third")).usual))
"""


@pytest.mark.slow
def test_identities_are_the_same_in_each_process(tmp_path):
    """Those of classes and functions too that a program has of itself: none is known by where it lies in memory."""
    first, second = (in_processes(1, BEGIN + IDENTITIES, tmp_path, PYTHONHASHSEED=seed)[0] for seed in "12")
    assert first == second
    assert len(set(first.split())) == 4  # the last two are the same function


SOLVING = """
import sys
import jax
import jax.numpy as jnp
from stickslip_jax._compiler import programs as kept
compiled, write = [], kept._write
kept._write = lambda path, *rest: compiled.append(path.name) or write(path, *rest)
def solved(matrix):
    return jnp.linalg.solve(matrix, jnp.arange(3.0))
print(kept.kept_jit(solved)(jnp.diag(jnp.array([1.0, 2.0, 4.0]))), len(compiled))
"""


@pytest.mark.slow
def test_a_program_that_calls_lapack_finds_it(tmp_path):
    """The process ended where that was not looked for."""
    (first,), (second,) = (in_processes(1, SOLVING, tmp_path / "programs") for _ in range(2))
    assert first.split() == ["[0.", "0.5", "0.5]", "1"]
    assert second.split() == ["[0.", "0.5", "0.5]", "0"]


def test_a_program_that_calls_a_function_from_elsewhere_is_not_kept(tmp_path, monkeypatch):
    """It may not be there in the next process."""
    monkeypatch.setenv(kept.VARIABLE, str(tmp_path / "programs"))
    written = []
    monkeypatch.setattr(kept, "_write", lambda *entry: written.append(entry))
    function = next(value for name, value, _ in lapack.registrations()["cpu"] if name == "lapack_dpotrf_ffi")
    jax.ffi.register_ffi_target("factor_of_a_user", function, platform="cpu")
    lapack.prepare_lapack_call("potrf", np.dtype(np.float64))

    def factor(name):
        def run(matrix):
            results = jax.ShapeDtypeStruct((2, 2), matrix.dtype), jax.ShapeDtypeStruct((), jnp.int32)
            return jax.ffi.ffi_call(name, results, input_output_aliases={0: 0})(matrix, uplo=np.uint8(76))[0]

        return jnp.tril(kept.kept_jit(run)(4 * jnp.eye(2, dtype=jnp.float64)))

    assert (factor("factor_of_a_user") == 2 * jnp.eye(2)).all()
    assert not written
    assert (factor("lapack_dpotrf_ffi") == 2 * jnp.eye(2)).all()
    assert len(written) == 1
