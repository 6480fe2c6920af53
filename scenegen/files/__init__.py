"""Files that are complete or absent, their hashes, and folders that hold nothing but our files.

`whole_files` writes files and folders that appear whole or not at all, in the temporary folders of
`partials`. `own_files` refuses to replace a folder with files of others. `inside` refuses paths that lead out
of a folder, and `plain_file` reads no pipe and no device. `locks` are for processes. May import
`scenegen.night_error`; nothing else of `scenegen`.
"""
