"""Files that are complete or absent, and their hashes.

`whole_files` writes files and folders that appear whole or not at all. `file_hashes` remembers the hashes of
files that have not changed. May import `scenegen.night_error`; nothing else of `scenegen`.
"""
