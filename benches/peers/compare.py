"""Times our engine beside onnxruntime and PyTorch on the same network, weights and pictures.

See README.md. Every program is a process that computes only on command; blocks of runs alternate, and ratios are
medians over blocks of the ratio of two neighbouring blocks, so that a change of the machine's speed cancels.
"""

import argparse
import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

HERE = Path(__file__).resolve().parent


class Peer:
    def __init__(self, name, command, env=None):
        self.name = name
        self.process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=env)
        self.wall, self.cpu = [], []

    def ask(self, command):
        self.process.stdin.write(command + "\n")
        self.process.stdin.flush()
        answer = self.process.stdout.readline()
        if not answer:
            raise SystemExit(f"{self.name} ended on '{command}'")
        return answer.strip()

    def block(self, runs, warm_up=True):
        """One block, after a pause in which the last program's spinning threads go to sleep, and one warm-up."""
        time.sleep(0.1)
        if warm_up:
            self.ask("run 1")
        times = np.array([float(t) for t in self.ask(f"run {runs}").split()]).reshape(-1, 2)
        self.wall.append(float(np.median(times[:, 0])))
        self.cpu.append(float(np.median(times[:, 1])))


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--weights", help="a weights folder; without it random weights of --width")
    parser.add_argument("--width", default="1.0")
    parser.add_argument("--side", type=int, default=224)
    parser.add_argument("--batch", type=int, default=1)
    parser.add_argument("--blocks", type=int, default=9)
    parser.add_argument("--runs", type=int, default=10, help="predictions in a block")
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--isa", default="best", help="avx512, avx2, portable, bf16 or best")
    parser.add_argument("--peers", nargs="*", default=["onnxruntime", "pytorch"], help="also: pytorch-bf16, ours-bf16")
    parser.add_argument("--ours", default=str(HERE / "../../target/debug/examples/peer"), help="the built example")
    args = parser.parse_args()

    with tempfile.TemporaryDirectory() as scratch:
        weights = args.weights or scratch + "/weights"
        if not args.weights:
            subprocess.run([args.ours, "make", weights, args.width], check=True)
        pictures = scratch + "/input.f32"
        shape = (args.batch, 3, args.side, args.side)
        np.random.default_rng(0).normal(size=shape).astype(np.float32).tofile(pictures)
        env = dict(os.environ, RAYON_NUM_THREADS=str(args.threads))
        engine = lambda name, isa: Peer(name, [args.ours, "serve", weights, pictures, str(args.batch), isa], env)
        ours = engine("where2act", args.isa)
        serve = [sys.executable, str(HERE / "serve.py")]
        rest = [weights, pictures, str(args.batch), str(args.threads)]
        other = lambda name: engine(name, "bf16") if name == "ours-bf16" else Peer(name, serve + [name] + rest)
        peers = [ours] + [other(name) for name in args.peers]

        # Asked before saving, which copies.
        memory = {peer.name: peer.ask("run 1") and int(peer.ask("memory")) / 2**20 for peer in peers}
        outputs = {}
        for peer in peers:
            file = f"{scratch}/{peer.name}.f32"
            peer.ask("save " + file)
            outputs[peer.name] = np.fromfile(file, np.float32)
        largest = np.abs(outputs[ours.name]).max()
        for peer in peers[1:]:
            error = np.abs(outputs[peer.name] - outputs[ours.name]).max() / largest
            print(f"{peer.name}: largest difference of the features {error:.1e} of the largest")
            limit = 1e-1 if any(name.endswith("bf16") for name in (args.isa, peer.name)) else 1e-4
            if not error < limit:
                raise SystemExit(f"outputs disagree: expected below {limit}")
        outputs.clear()

        for block in range(args.blocks):
            for peer in peers:
                peer.block(args.runs)
        print(f"{'':16}{'wall ms':>10}{'CPU ms':>10}{'peak MiB':>10}{'ours / it':>11}{'range of blocks':>20}")
        for peer in peers:
            ratios = [a / b for a, b in zip(ours.wall, peer.wall)]
            print(
                f"{peer.name:16}{statistics.median(peer.wall) * 1e3:10.1f}{statistics.median(peer.cpu) * 1e3:10.1f}"
                f"{memory[peer.name]:10.0f}{statistics.median(ratios):11.2f}"
                f"{min(ratios):12.2f} - {max(ratios):.2f}"
            )
        print("stages of one prediction of ours:", ours.ask("stages"))


if __name__ == "__main__":
    main()
