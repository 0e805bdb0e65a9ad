"""Compare the cost of decode with that of mcap's own reader."""
