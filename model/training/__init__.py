"""The training loop and all that only training needs.

Here: loop, step, optimiser, checkpoints, several processes, TensorBoard, stopping and resuming. May import
`model.data`, `model.network`, the run folder and the settings; neither `model.prediction` nor `model.report`.
"""
