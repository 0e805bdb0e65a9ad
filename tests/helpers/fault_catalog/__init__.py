"""Faults of recordings by name: all_faults lists them, fault_table measures them for
docs/faults.md."""
