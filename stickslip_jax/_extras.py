"""The extras of the package: what needs one that is not installed says so in one sentence, before it does any work."""

import sys
from importlib.util import find_spec


def require(needing: str, extra: str, *packages: str) -> None:
    """Raises ImportError where one of the `packages`, which the `extra` brings, is not installed.

    `needing`: who needs them, with the verb: "Sweeps need".
    """
    missing = [name for name in packages if not _is_installed(name)]
    if missing:
        raise ImportError(f"{needing} {', '.join(missing)}: pip install 'stickslip_jax[{extra}]'.")


def _is_installed(name: str) -> bool:
    return sys.modules[name] is not None if name in sys.modules else find_spec(name) is not None
