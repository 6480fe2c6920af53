"""Files that are whole or not there, and their hashes. Imports nothing else of `scenegen`."""
