"""Renders a page to PDF."""

import logging
from typing import Any

from markupsafe import Markup

from calib.report.figures.figure_encoding import Drawing, encode_for_paper

NOISY_LOGGERS = ("weasyprint", "weasyprint.progress", "fontTools")


class PdfImages:
    """Images of a page by short URLs: inside the page, megabytes would be parsed as text."""

    def __init__(self) -> None:
        self.content_by_url: dict[str, tuple[str, bytes]] = {}

    def add_drawing(self, drawing: Drawing) -> Markup:
        """Add a drawing and return its <img> element."""
        url = f"drawing:{len(self.content_by_url)}"
        self.content_by_url[url] = encode_for_paper(drawing)
        return Markup(f'<img alt="" src="{url}">')


def encode_pdf(html: str, pdf_images: PdfImages) -> bytes:
    """Encode a page and its images as PDF; the same page gives the same bytes."""
    # Their messages are on single steps, imports, and CSS rules that only the screen needs.
    for name in NOISY_LOGGERS:
        logging.getLogger(name).setLevel(logging.ERROR)
    import weasyprint  # takes 1 s, which only this job needs
    from weasyprint.urls import URLFetcher, URLFetcherResponse

    class PdfImageFetcher(URLFetcher):
        """Opens the images and the data inside them, and nothing else."""

        def fetch(self, url: str, headers: dict[str, str] | None = None) -> Any:
            if url not in pdf_images.content_by_url:
                return super().fetch(url, headers)
            media_type, data = pdf_images.content_by_url[url]
            return URLFetcherResponse(url, data, {"Content-Type": media_type})

    fetcher = PdfImageFetcher(allowed_protocols={"data"})
    page = weasyprint.HTML(string=html, url_fetcher=fetcher)
    # A PDF needs an identifier; by default it is random.
    return page.write_pdf(pdf_identifier=b"report")
