"""What people read: the HTML page, the PDF, the page of all rigs, and texts for the terminal."""
