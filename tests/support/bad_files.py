"""Files of studies and sweeps in which one value, key or section is wrong."""

import re
import tempfile
import warnings
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path

from stickslip_jax.study import StudyError
from stickslip_jax.study._reading import read_config, read_sweep_config
from stickslip_jax.study._run import built, sweep_of
from support.bad_values import Draw

_GAP = '[base.gap]\nlaw = "Weibull"\nscale = 1.0\nshape = 2.0\n'
_SPECTRUM = '[base.spectrum]\nlaw = "KanaiTajimiSpectrum"\n'
FILES = {
    "switching": '[base]\nlaw = "PoissonSwitching"\nspeed = 1.0\nrate = 1.0\n',
    "cart": '[system]\nmodel = "MotorCart"\n',
    "semi-markov": f'[base]\nlaw = "SemiMarkovSwitching"\nspeed = 1.0\n{_GAP}',
    "gaussian": f'[base]\nlaw = "GaussianProcess"\ncutoff = 50.0\n{_SPECTRUM}',
    "recorded": '[base]\nlaw = "Recorded"\ntimes = [0.0, 300.0]\nvalues = [0.0, 1.0]\n',
    "steps": '[base]\nlaw = "RandomSteps"\nspeed = 1.0\ninterval = 1.0\n',
}
SWEPT = '[sweep]\nkeep = "totals"\n[sweep.over]\nmu = [0.5, 1.0]\nmass = { linspace = [1.0, 2.0, 3] }\n'

LITERALS: tuple[Callable[[Draw], str], ...] = (
    *(lambda draw, text=text: text for text in (
        "0", "-1", "0.0", "-0.5", "1e308", "-1e308", "1e-308", "inf", "-inf", "nan", "true", "false", '""', '"a"',
        '"1.0"', '"Uniform"', '"~nobody-here/x"', r'"a\u0000b"', r'"\ud7ff"', "'two words'", "1979-05-27", "07:32:00",
        "1979-05-27T07:32:00Z", "0xff", "1_000", "[]", "[1, 2]", "[[1], [2, 3]]", '["a", 1]', "[true]", "[nan]", "{}",
        "{ a = 1 }", "{ low = 1.0, high = 0.0 }", "{ low = -1e308, high = 1e308 }", '{ law = "Uniform" }',
        '{ law = ["Uniform"] }', "{ linspace = [1, 2, 1000000000] }", "{ linspace = [1, 2, 0] }",
        "{ logspace = [0, 1, 2] }", "{ linspace = 3 }", "[{ a = 1 }, { a = 2 }]", "[[[[[[1]]]]]]",
    )),
    lambda draw: "9" * int(draw.integers(20, 400)),
    lambda draw: "9" * int(draw.integers(5000, 20_000)),
    lambda draw: "[" * 3000 + "]" * 3000,
    lambda draw: f"{10 ** draw.uniform(-300, 300):g}",
    lambda draw: str(int(draw.integers(-(2**62), 2**62))),
    lambda draw: '"' + "x" * int(draw.integers(1000, 9999)) + '"',
    lambda draw: "[" + ", ".join(["1.0"] * int(draw.integers(1, 200))) + "]",
)  # fmt: skip
_LINE = re.compile(r"^(?:# )?(?P<key>[\w\"., -]+?) = ?.*$")


@cache
def complete(name: str, *, swept: bool) -> tuple[str, ...]:
    """The lines of a file with every key that it may have."""
    text = FILES[name] + (SWEPT if swept else "")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "study.toml"
        path.write_text(text)
        config = (read_sweep_config if swept else read_config)(path)
    return tuple(config.to_toml().splitlines())


def mutated(draw: Draw, lines: tuple[str, ...]) -> tuple[str, str]:
    """The text of a file with one thing wrong, and which."""
    changed = list(lines)
    literal = LITERALS[draw.integers(len(LITERALS))](draw)
    how = draw.uniform()
    places = [place for place, line in enumerate(lines) if _LINE.match(line) and not line.startswith("# [")]
    headers = [place for place, line in enumerate(lines) if line.startswith("[")]
    if how < 0.75:
        place = int(draw.choice(places))
        found = _LINE.match(lines[place])
        assert found is not None
        changed[place] = f"{found['key']} = {literal}"
    elif how < 0.85:
        place = int(draw.choice(headers))
        key = str(draw.choice(["mas", "x", '""', "speed", "law", "model", '"a.b"', "t1", "over"]))
        changed.insert(place + 1, f"{key} = {literal}")
    elif how < 0.9:
        place = int(draw.choice(headers))
        changed[place] = str(
            draw.choice(["[sytem]", "[base.gap.x]", "[[system]]", "[run.run]", "[sweep.over.mu]", "[]"])
        )
    elif how < 0.95:
        place = int(draw.choice(places))
        del changed[place]
    else:
        place = 0
        changed.insert(0, f"{draw.choice(['system', 'base', 'run', 'sweep', 'output'])} = {literal}")
    return "\n".join(changed) + "\n", f"line {place}: {changed[min(place, len(changed) - 1)][:60]}"


def cases(draw: Draw, number: int) -> Iterator[tuple[str, str, bool]]:
    """Names of cases, their texts, and whether they are of sweeps."""
    for _ in range(number):
        name, swept = str(draw.choice(list(FILES))), bool(draw.integers(2))
        text, place = mutated(draw, complete(name, swept=swept))
        yield f"{name}{' swept' if swept else ''}, {place}", text, swept


def outcome(text: str, path: Path, *, swept: bool) -> str:
    """What is obscure about what is said of a file; "" if nothing is."""
    path.write_text(text)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            config = (read_sweep_config if swept else read_config)(path)
            if swept:
                sweep_of(config, f"{path}: ")
            else:
                built(config.system, "system")
                built(config.base, "base")
    except StudyError as error:
        said = str(error)
        is_sentence = "\n" not in said and said.endswith((".", "?")) and len(said) < 2000
        return "" if is_sentence else f"StudyError: {said[:300]}"
    except BaseException as error:
        return f"{type(error).__name__}: {str(error)[:200]}"
    return ""
