"""Training: `loop` runs the epochs, `epoch` and `step` are their parts, `state` is saved and resumed.

Also fine-tuning, the optimiser, the checkpoint file, several processes, TensorBoard, interruption by signals,
and the checks that refuse a training. May import `model.data`, `model.network`, the run folder, the device
and the settings; neither `model.prediction` nor `model.judging`.
"""
