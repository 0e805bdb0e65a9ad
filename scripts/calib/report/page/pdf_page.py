"""The page on paper."""

import logging

from markupsafe import Markup

from calib.report.figures.svg_plots import encode_for_paper

NOISY_LOGGERS = ("weasyprint", "weasyprint.progress", "fontTools")


class PdfImages:
    """What the page shows, under short names: inside it, megabytes would be parsed as text."""

    def __init__(self):
        self.content_by_url = {}

    def add_drawing(self, drawing):
        """<img> of a Drawing."""
        name = f"drawing:{len(self.content_by_url)}"
        self.content_by_url[name] = encode_for_paper(drawing)
        return Markup(f'<img alt="" src="{name}">')


def encode_pdf(html, pdf_images):
    """PDF bytes of a page and its Images; the same page gives the same bytes."""
    # They tell of every step, the import's own too, and of rules for the screen that do not apply.
    for name in NOISY_LOGGERS:
        logging.getLogger(name).setLevel(logging.ERROR)
    import weasyprint  # 1 s, which only the job that prints should pay
    from weasyprint.urls import URLFetcher, URLFetcherResponse

    class Known(URLFetcher):
        """Opens the images and what lies within them, and nothing from outside."""

        def fetch(self, url, headers=None):
            if url not in pdf_images.content_by_url:
                return super().fetch(url, headers)
            kind, data = pdf_images.content_by_url[url]
            return URLFetcherResponse(url, data, {"Content-Type": kind})

    page = weasyprint.HTML(string=html, url_fetcher=Known(allowed_protocols={"data"}))
    # A PDF must carry an identifier; by default it is drawn anew for every file.
    return page.write_pdf(pdf_identifier=b"report")
