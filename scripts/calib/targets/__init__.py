"""Targets: target_shapes is the registry of shapes (board, cylinder, template cloud); patterns/
holds what is printed on boards; board_pdf prints one."""
