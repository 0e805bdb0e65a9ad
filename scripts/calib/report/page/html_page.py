"""Pages from templates, complete in themselves."""

import json

import jinja2
from markupsafe import Markup


def render_template(paths, template_name, context, render_drawing=None):
    """The page that the template of a name makes of what is shown; paths: of all templates, styles
    and scripts; render_drawing: how it puts a Drawing, by default as its <svg>."""
    environment = jinja2.Environment(
        loader=jinja2.DictLoader({path.name: path.read_text() for path in paths}),
        autoescape=lambda template: template.endswith(".html.j2"),
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["drawn"] = render_drawing or (lambda drawing: Markup(drawing.svg))
    environment.filters["data"] = embed_json
    return environment.get_template(template_name).render(context)


def embed_json(value):
    """Content as JSON that may stand in a page's <script>."""
    told = json.dumps(value, separators=(",", ":"), allow_nan=False)
    return Markup(told.replace("<", "\\u003c"))
