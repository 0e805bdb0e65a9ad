"""Renders Jinja templates into pages that need no other files."""

import json
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import jinja2
from markupsafe import Markup

from calib.report.figures.figure_encoding import Drawing


def render_svg(drawing: Drawing) -> Markup:
    """Return the <svg> element of a drawing."""
    return Markup(drawing.svg)


def render_template(
    paths: Iterable[Path],
    template_name: str,
    context: dict[str, Any],
    render_drawing: Callable[[Drawing], Markup] = render_svg,
) -> str:
    """Render a template; paths: of all templates, styles and scripts that it includes."""
    environment = jinja2.Environment(
        loader=jinja2.DictLoader({path.name: path.read_text() for path in paths}),
        autoescape=lambda name: name is not None and name.endswith(".html.j2"),
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["as_drawing"] = render_drawing
    environment.filters["as_json"] = embed_json
    return environment.get_template(template_name).render(context)


def embed_json(value: Any) -> Markup:
    """Return a value as JSON that may stand in a <script> of a page."""
    text = json.dumps(value, separators=(",", ":"), allow_nan=False)
    return Markup(text.replace("<", "\\u003c"))
