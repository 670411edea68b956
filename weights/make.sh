#!/usr/bin/env bash
# Makes weights of the kind of weights/cloud and then weights/rgb from nothing, on two cores: two hours for the data, four and a
# half for scans, by the speeds of its steps seven and a half for pictures, and half an hour for judging both.
# `weights/make.sh cloud` leaves out pictures. What is interrupted goes on when this is run again, in the same folder.
# `REHEARSE=1 weights/make.sh` does all of it with a few scenes and steps, in minutes, under data/rehearsal and runs/rehearsal.
set -euo pipefail
cd "$(dirname "$0")/.."
kinds=${1:-cloud rgb}
data=data runs=runs fewer=1 few=() scenes=180
if [[ -n ${REHEARSE:-} ]]; then
    data=data/rehearsal runs=runs/rehearsal fewer=40 few=(--looks 4 --steps 8) scenes=4
fi

resume() { [[ -e $1 ]] && echo --resume || true; }

collect() { # folder, scenes, what kind
    cargo run --bin collect -- --randomise --wide --scenes $(($2 / fewer)) --out "$data/$1" $(resume "$data/$1") "${@:3}"
}
train() { # configuration, run, what else
    cargo run --bin train -- --config "configs/$1.toml" --out "$runs/$2" --episodes 0 $(resume "$runs/$2") "${few[@]}" "${@:3}"
}

collect looks 24000 --trials 0 --object-seeds 0..10000 --seed 5
collect trials 4000 --trials 40 --guided 0.6 --seed 1
collect random 3000 --trials 60 --guided 0 --object-seeds 0..10000 --seed 21

wide=(--data "$data/trials" --data "$data/looks")
train standard cloud-first "${wide[@]}"
train standard-more cloud-more "${wide[@]}" --from "$runs/cloud-first/last" --replay "$runs/cloud-first"
wide+=(--data "$data/random")
train standard-end cloud-end "${wide[@]}" --from "$runs/cloud-more/last" --replay "$runs/cloud-more"
train standard-mean cloud "${wide[@]}" --from "$runs/cloud-end/last" --replay "$runs/cloud-end"
# Scans teach pictures, and the trials that they made are the first that pictures learn from.
if [[ $kinds == *rgb* ]]; then
    teacher=(--teacher "$runs/cloud/last")
    train standard-rgb rgb-first "${wide[@]}" "${teacher[@]}" --seed 3 --replay "$runs/cloud"
    collect close-looks 14000 --trials 0 --close 0.75 --object-seeds 0..10000 --seed 101
    collect close-trials 4000 --trials 32 --guided 0.6 --close 0.75 --object-seeds 0..10000 --seed 102
    train standard-rgb-close rgb --data "$data/close-trials" --data "$data/close-looks" "${teacher[@]}" --from "$runs/rgb-first/last"
fi
for kind in $kinds; do
    cargo run --bin evaluate -- --weights "$runs/$kind/last" --episodes $scenes --out "$runs/$kind/shapes.json"
done
