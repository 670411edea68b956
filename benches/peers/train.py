"""Times a training step of ours (forward, backward, Adam) beside PyTorch and beside burn's own operations.

The same U-Net, weights, pictures and loss; the losses of the first steps are compared before anything is timed. See
README.md. `tuned` is an allocator that keeps large buffers: `KeepLarge` of where2act-kernels for ours and burn, glibc's
own settings for PyTorch.
"""

import argparse
import os
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

from compare import HERE, Peer

TUNED = {
    "MALLOC_MMAP_THRESHOLD_": "4294967296",
    "MALLOC_TRIM_THRESHOLD_": "17179869184",
    "MALLOC_TOP_PAD_": "268435456",
}
KINDS = ["pytorch-nchw", "pytorch", "pytorch-tuned", "where2act-default", "burn", "burn-default"]


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--width", default="0.5")
    parser.add_argument("--side", type=int, default=224)
    parser.add_argument("--batch", type=int, default=8)
    parser.add_argument("--blocks", type=int, default=7)
    parser.add_argument("--runs", type=int, default=1, help="steps in a block")
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--isa", help="avx512, avx2 or portable; default: the best")
    parser.add_argument("--peers", nargs="*", default=KINDS, choices=KINDS)
    parser.add_argument("--ours", default=str(HERE / "../../target/debug/examples/peer"), help="the built example")
    args = parser.parse_args()

    with tempfile.TemporaryDirectory() as scratch:
        weights, pictures = scratch + "/weights", scratch + "/input.f32"
        subprocess.run([args.ours, "make", weights, args.width], check=True)
        shape = (args.batch, 3, args.side, args.side)
        np.random.default_rng(0).normal(size=shape).astype(np.float32).tofile(pictures)
        env = dict(os.environ, RAYON_NUM_THREADS=str(args.threads))
        if args.isa:
            env["WHERE2ACT_ISA"] = args.isa
        rest = [weights, pictures, str(args.batch)]
        default, tuned = args.ours, args.ours + "_tuned"
        serve = [sys.executable, str(HERE / "serve.py")]
        torch = lambda layout: [*serve, "train-" + layout, *rest, str(args.threads)]
        commands = {
            "where2act": ([tuned, "train", *rest, "fast"], env),
            "where2act-default": ([default, "train", *rest, "fast"], env),
            "burn": ([tuned, "train", *rest, "burn"], env),
            "burn-default": ([default, "train", *rest, "burn"], env),
            "pytorch-nchw": (torch("nchw"), env),
            "pytorch": (torch("channels-last"), env),
            "pytorch-tuned": (torch("channels-last"), {**env, **TUNED}),
        }
        peers = [Peer(name, *commands[name]) for name in ["where2act", *args.peers]]

        # The first loss depends on the forward pass, the second on the gradients; Adam turns rounding of tiny
        # gradients into whole steps, so that later ones say less.
        losses = {peer.name: [float(loss) for loss in peer.ask("loss 2").split()] for peer in peers}
        print("losses of the first steps:", *losses["where2act"])
        for peer in peers[1:]:
            for found, expected, limit in zip(losses[peer.name], losses["where2act"], (1e-4, 1e-2)):
                if not abs(found / expected - 1) < limit:
                    raise SystemExit(f"{peer.name}: loss {found}, ours {expected}: not within {limit}")
        for block in range(args.blocks):
            for peer in peers:
                peer.block(args.runs, warm_up=False)
        print(f"{'':18}{'wall ms':>9}{'CPU ms':>9}{'peak MiB':>10}{'ours / it':>11}{'range of blocks':>18}{'CPU':>7}")
        ours = peers[0]
        for peer in peers:
            ratios = [a / b for a, b in zip(ours.wall, peer.wall)]
            cpu = statistics.median(a / b for a, b in zip(ours.cpu, peer.cpu))
            print(
                f"{peer.name:18}{statistics.median(peer.wall) * 1e3:9.0f}{statistics.median(peer.cpu) * 1e3:9.0f}"
                f"{int(peer.ask('memory')) / 2**20:10.0f}{statistics.median(ratios):11.2f}"
                f"{min(ratios):10.2f} - {max(ratios):.2f}{cpu:9.2f}"
            )


if __name__ == "__main__":
    main()
