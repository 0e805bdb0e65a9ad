"""What simulated sensors measure: scans, images, motion capture poses and their errors."""
