"""Using a trained network: on arrays, on measurement files, as an ONNX file.

`predictor` is the network as a function; the other modules read measurement files (.exr, .npz, .h5) and write
depth maps, pictures, point clouds and ONNX files. May import `itof`, `scenegen`, `model.network`, the run
folder, the device and the settings; neither `model.data` nor `model.training`.
"""
