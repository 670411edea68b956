"""A peer that runs on command, so that only one program computes at a time.

usage: serve.py onnxruntime|pytorch|pytorch-bf16 WEIGHTS INPUT BATCH THREADS
       serve.py train-nchw|train-channels-last WEIGHTS INPUT BATCH THREADS

Commands on stdin, as of our own side: `run N`, `memory`; of predictors also `save FILE`, of trainers `loss N`.
"""

import os
import resource
import subprocess
import sys
import tempfile
import time
import warnings

warnings.filterwarnings("ignore")
kind, folder, input_file, batch, threads = sys.argv[1:]
batch, threads = int(batch), int(threads)
os.environ["OMP_NUM_THREADS"] = str(threads)

import numpy as np


def cpu_seconds():
    usage = resource.getrusage(resource.RUSAGE_SELF)
    return usage.ru_utime + usage.ru_stime


def export(path):
    """Writes the network as ONNX; in a process of its own, so that PyTorch does not count as onnxruntime's memory."""
    import torch

    import unet

    net, side = unet.load(folder)
    x = torch.zeros(batch, 3, side, side)
    torch.onnx.export(net, (x,), path, input_names=["x"], output_names=["y"], dynamo=False)


def onnxruntime_run(x):
    import onnxruntime as ort

    with tempfile.TemporaryDirectory() as scratch:
        path = os.path.join(scratch, "unet.onnx")
        subprocess.run([sys.executable, __file__, "export:" + path, *sys.argv[2:]], check=True)
        options = ort.SessionOptions()
        options.intra_op_num_threads = threads
        session = ort.InferenceSession(path, options, providers=["CPUExecutionProvider"])
    _, channels, height, width = session.get_inputs()[0].shape
    feed = {"x": x.reshape(batch, channels, height, width)}
    return lambda: session.run(None, feed)[0]


def pytorch_run(x, bf16):
    import torch

    import unet

    torch.set_num_threads(threads)
    dtype = torch.bfloat16 if bf16 else torch.float32
    net, side = unet.load(folder)
    x = torch.from_numpy(x.reshape(batch, 3, side, side)).to(dtype)
    x = x.contiguous(memory_format=torch.channels_last)
    with torch.inference_mode():
        net = torch.jit.freeze(torch.jit.trace(net.to(dtype).to(memory_format=torch.channels_last), x))

    def run():
        with torch.inference_mode():
            return net(x).float().numpy()

    return run


def training_step(x, memory_format):
    """Adam on the mean square of the features at some pixels, as crates/model/examples/peer/training.rs has it."""
    import torch

    import unet

    torch.set_num_threads(threads)
    net, side = unet.load(folder)
    net = net.train().to(memory_format=memory_format)
    x = torch.from_numpy(x.reshape(batch, 3, side, side)).contiguous(memory_format=memory_format)
    adam = torch.optim.Adam(net.parameters(), lr=1e-3, eps=1e-8)
    view = torch.arange(batch).repeat_interleave(64)
    pixel = torch.arange(64).repeat(batch) * 7919 % (side * side)

    def run():
        adam.zero_grad()
        loss = net.features_at(x, view, pixel // side, pixel % side).square().mean()
        loss.backward()
        adam.step()
        return loss.item()

    return run


def predictor(x):
    return onnxruntime_run(x) if kind == "onnxruntime" else pytorch_run(x, kind == "pytorch-bf16")


def trainer(x):
    import torch

    layout = torch.channels_last if kind == "train-channels-last" else torch.contiguous_format
    return training_step(x, layout)


def main():
    if kind.startswith("export:"):
        export(kind.removeprefix("export:"))
        return
    x = np.fromfile(input_file, np.float32)
    run = trainer(x) if kind.startswith("train") else predictor(x)
    for line in sys.stdin:
        command, *rest = line.split()
        if command == "run":
            times = []
            for _ in range(int(rest[0])):
                cpu, wall = cpu_seconds(), time.perf_counter()
                run()
                times += [time.perf_counter() - wall, cpu_seconds() - cpu]
            print(*times, flush=True)
        elif command == "loss":
            print(*(run() for _ in range(int(rest[0]))), flush=True)
        elif command == "save":
            features = run()
            rows = features.reshape(batch, features.shape[1], -1).transpose(0, 2, 1)
            rows.astype(np.float32).tofile(rest[0])
            print("saved", flush=True)
        elif command == "memory":
            print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024, flush=True)


main()
