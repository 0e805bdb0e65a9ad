"""Bounds of what a log may ask for: memory and time are linear in the bytes of its file.

decompression      bounded decompression of messages, chunks and files
definition_budget  message definitions, before they are compiled
mcap_chunks        chunks of an MCAP file, and its index
overlap_budget     chunks of a log that overlap in time
sqlite_budget      tables of an SQLite file
"""
