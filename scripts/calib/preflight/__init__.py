"""What recordings can and cannot support, by all that is known before a sensor's data are read.

looks      what each sensor may see of the targets in a session, by the log's audit and the MCS
judgement  what follows for the calibration: findings like the verdict's, and numbers as JSON
words      both as lines for people
"""
