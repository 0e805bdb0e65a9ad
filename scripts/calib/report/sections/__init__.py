"""Sections of the report: each file computes the tables of one section."""
