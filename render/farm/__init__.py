"""Many scenes on many workers: what `night-render DATASET` does.

Here: the plan, the inventory, claims, the queue, jobs, Dask clusters, and the status. The queue (`queue`)
tries a scene again that failed. May import `render.rendering` and the settings; not `render.products`.
"""
