"""Sections of the report: each file computes the tables of the section with its name."""
