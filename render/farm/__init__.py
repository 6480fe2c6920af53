"""Many scenes on many workers: what `night-render DATASET` does.

Here: plan, inventory, claims, queue, jobs and Dask clusters, and the status read from the files. A scene that
fails is tried again in `queue`. May import `render.rendering` and the settings; not `render.products`.
"""
