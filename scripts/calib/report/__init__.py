"""Stage report: data/ loads a run, sections/ compute tables, figures/ and overlays/ draw, page/
renders HTML, PDF and terminal text from the templates in workflow/report."""
