"""Using a trained network: on arrays, on measurement files, as an ONNX file.

Here: the predictor, readers of measurement files (.exr, .npz, .h5), and the depth maps, pictures and point
clouds that are written. May import `model.network`, the run folder and the settings; neither shards nor
training.
"""
