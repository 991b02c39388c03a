"""Equations as MathML, which browsers draw by themselves: no script, no network."""

from docutils import nodes
from docutils.utils.math import MathError
from docutils.utils.math.latex2mathml import tex2mathml
from sphinx.errors import ExtensionError


def _renderer(tag, *, as_block):
    def visit(writer, node):
        try:
            equation = tex2mathml(node.astext(), as_block=as_block)
        except MathError as error:
            raise ExtensionError(f"{node.source}: {node.astext()!r}: {error}") from None
        writer.body.append(writer.starttag(node, tag, equation, CLASS="math") + f"</{tag}>")
        raise nodes.SkipNode

    return visit, None


def setup(app):
    """Register the renderer, which conf.py names."""
    app.add_html_math_renderer(
        "mathml", _renderer("span", as_block=False), _renderer("div", as_block=True)
    )
    return {"parallel_read_safe": True, "parallel_write_safe": True}
