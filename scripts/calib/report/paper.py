"""The page on paper."""

import logging

CHATTY = ("weasyprint", "weasyprint.progress", "fontTools")


def to_pdf(html):
    """PDF bytes of a page; the same page gives the same bytes."""
    # They tell of every step, the import's own too, and of rules for the screen that do not apply.
    for name in CHATTY:
        logging.getLogger(name).setLevel(logging.CRITICAL)
    import weasyprint  # 1 s, which only the job that prints should pay

    # A PDF must carry an identifier; by default it is drawn anew for every file.
    return weasyprint.HTML(string=html).write_pdf(pdf_identifier=b"report")
