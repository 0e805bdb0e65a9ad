"""Are the reported σ true? Halves of recordings, and errors that a fit could know.

split_half_draws  halvings of the keypoints of finished runs
known_errors      σ where beams, boards or mounts err, over σ of a fit that knows the error
split_half_page   section of docs/benchmark.md, and the command that writes it
"""
