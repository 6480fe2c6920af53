"""Files that are complete or absent, and their hashes. Imports nothing else of `scenegen`."""
