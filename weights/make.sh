#!/usr/bin/env bash
# Makes weights of the kind of weights/cloud and then weights/rgb from nothing, on two cores: two hours for the data, four and a
# half for scans, by the speeds of its steps seven and a half for pictures, and half an hour for judging both.
# `weights/make.sh cloud` leaves out pictures. What is interrupted goes on when this is run again, in the same folder.
set -euo pipefail
cd "$(dirname "$0")/.."
kinds=${1:-cloud rgb}

resume() { [[ -e $1 ]] && echo --resume || true; }

cargo run --bin collect -- --scenes 24000 --trials 0 --randomise --wide --object-seeds 0..10000 --seed 5 --out data/looks \
    $(resume data/looks)
cargo run --bin collect -- --scenes 4000 --trials 40 --guided 0.6 --randomise --wide --seed 1 --out data/trials \
    $(resume data/trials)
cargo run --bin collect -- --scenes 3000 --trials 60 --guided 0 --randomise --wide --object-seeds 0..10000 --seed 21 \
    --out data/random $(resume data/random)

train() {
    cargo run --bin train -- --config "configs/$1.toml" --out "runs/$2" --data data/trials --data data/looks --episodes 0 \
        $(resume "runs/$2") "${@:3}"
}
train standard cloud-first
train standard-more cloud-more --from runs/cloud-first/last --replay runs/cloud-first
train standard-end cloud-end --from runs/cloud-more/last --replay runs/cloud-more --data data/random
train standard-mean cloud --from runs/cloud-end/last --replay runs/cloud-end --data data/random
# Scans teach pictures, and the trials that they made are the first that pictures learn from.
if [[ $kinds == *rgb* ]]; then
    train standard-rgb rgb-first --seed 3 --teacher runs/cloud/last --replay runs/cloud --data data/random
    close=(--randomise --wide --close 0.75 --object-seeds 0..10000)
    cargo run --bin collect -- --scenes 14000 --trials 0 "${close[@]}" --seed 101 --out data/close-looks $(resume data/close-looks)
    cargo run --bin collect -- --scenes 4000 --trials 32 --guided 0.6 "${close[@]}" --seed 102 --out data/close-trials \
        $(resume data/close-trials)
    cargo run --bin train -- --config configs/standard-rgb-close.toml --from runs/rgb-first/last --teacher runs/cloud/last \
        --data data/close-trials --data data/close-looks --out runs/rgb --episodes 0 $(resume runs/rgb)
fi
for kind in $kinds; do
    cargo run --bin evaluate -- --weights "runs/$kind/last" --episodes 180 --out "runs/$kind/shapes.json"
done
