"""Training on fresh scenes: worker processes draw and render them while the network trains.

`model.settings.fresh` says which scenes there are, `workers` makes them, `feed` delivers them in batches.
Only `workers` imports `render`, in its processes.
"""
