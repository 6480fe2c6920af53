"""Imports what the commands need, once, in the process that is forked for each command (`forked`).

Nothing here may start a thread: a fork does not copy threads. Mitsuba and Blender start some, so the commands
that need them import them in the child.
"""
# ruff: noqa: F401

import gc
import sys
import weakref
from pathlib import Path

import array_api_compat.numpy
import array_api_compat.torch
import dask_jobqueue
import h5py
import judgement
import PIL.Image
import reading
import torch._dynamo
import torch.utils.tensorboard
import trimesh

import cli
import commandline.streams_and_caches
import model.judging.evaluation
import model.prediction.prediction_files
import model.training.loop
import night_nlos
import render.farm.clusters
import render.farm.run
import render.farm.status
import render.products.dataset_export
import render.products.movie
import render.products.preview
import render.products.verification
import scenegen.making.generation
import scenegen.making.meshes
from itof.pictures.panels import font

torch.set_num_threads(1)
PIL.Image.init()
font().getlength("the first text costs most")
for finalizer in list(weakref.finalize._registry):  # of PyTorch's operators: 30 ms at each child's exit
    finalizer.atexit = False
gc.collect()
gc.freeze()  # so that collections in children do not copy these pages
THREADS = len(list(Path("/proc/self/task").iterdir()))
SYS_PATH = sys.path[:]
