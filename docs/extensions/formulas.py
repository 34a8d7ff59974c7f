"""Formulas as MathML, made while the site is built: browsers show it without a script and without the net."""

from docutils import nodes
from docutils.utils.math import MathError
from docutils.utils.math.latex2mathml import tex2mathml
from sphinx.errors import SphinxError


def mathml(latex: str, as_block: bool = False) -> str:
    """A formula as MathML.

    Raises:
        SphinxError: with the formula, if it holds a command that docutils does not know.
    """
    try:
        return tex2mathml(latex, as_block=as_block)
    except MathError as error:
        raise SphinxError(f"The formula {latex!r} cannot be shown: {error} Write it with other commands.") from None


def _inline(self, node: nodes.math) -> None:
    self.body.append(f'<span class="math">{mathml(node.astext())}</span>')
    raise nodes.SkipNode


def _block(self, node: nodes.math_block) -> None:
    self.body.append(f'<div class="math">{mathml(node.astext(), as_block=True)}</div>')
    raise nodes.SkipNode


def setup(app) -> dict[str, bool]:
    """What Sphinx calls first."""
    app.add_html_math_renderer("mathml", (_inline, None), (_block, None))
    return {"parallel_read_safe": True, "parallel_write_safe": True}
