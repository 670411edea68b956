#!/usr/bin/env bash
# Makes weights of the kind of weights/cloud from nothing: half an hour for the data, some three hours for training and a
# quarter for judging, on two cores. What is interrupted goes on when this is run again, in the same folder.
set -euo pipefail
cd "$(dirname "$0")/.."

resume() { [[ -e $1 ]] && echo --resume || true; }

cargo run --bin collect -- --scenes 24000 --trials 0 --randomise --wide --object-seeds 0..10000 --seed 5 --out data/looks \
    $(resume data/looks)
cargo run --bin collect -- --scenes 4000 --trials 40 --guided 0.6 --randomise --wide --seed 1 --out data/trials \
    $(resume data/trials)
cargo run --bin train -- --config configs/standard.toml --data data/trials --data data/looks --out runs/cloud-first \
    --episodes 0 $(resume runs/cloud-first)
cargo run --bin train -- --config configs/standard-more.toml --from runs/cloud-first/last --replay runs/cloud-first \
    --data data/trials --data data/looks --out runs/cloud --episodes 0 $(resume runs/cloud)
cargo run --bin evaluate -- --weights runs/cloud/last --episodes 180 --out runs/cloud/shapes.json
