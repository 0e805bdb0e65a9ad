"""Faults of recordings × what the verdict says: the matrix of docs/faults.md.

matrix_faults      the faults as data: simulator, messages, config, causes
message_changes    faults of the messages of a recording
config_mistakes    faults of what is written in the config
fault_recording    a recording with a fault but without noise
stage_runner       the stages in this process, from what changed on
noise_redraw       the noise of real rooms on the keypoints and poses of a run
row_measurement    one row: the whole run, its draws, and its draws after the first advice
draw_outcome       what a draw says, and by how much its poses err
matrix_goals       the summary against the goals
matrix_page        the tables of the page
fault_matrix       the command
"""
