#!/usr/bin/env bash
# Makes weights of the kind of weights/cloud and then weights/rgb from nothing, on two cores: two hours for the data, four and a
# half for scans, by the speeds of its steps seven and a half for pictures, and half an hour for judging both; 38 GB under data/.
# `weights/make.sh cloud` leaves out pictures (23 GB). What is interrupted goes on when this is run again. The weights are then in
# runs/cloud/last and runs/rgb/last, and their rates in shapes.md beside these; weights/ stays as it is.
# `REHEARSE=1 weights/make.sh` does all of it with a few scenes and steps, in minutes, to see that it can be done here. It begins
# anew each time, under data/rehearsal and runs/rehearsal.
set -euo pipefail
cd "$(dirname "$0")/.."
case "$*" in
    '') kinds='cloud rgb' ;;
    cloud) kinds=cloud ;;
    *) echo "usage: [REHEARSE=1] weights/make.sh [cloud]" >&2; exit 2 ;;
esac
data=data runs=runs fewer=1 few='' scenes=180
if [[ ${REHEARSE:-} == 1 ]]; then
    data=data/rehearsal runs=runs/rehearsal fewer=40 few='--looks 4 --steps 8' scenes=4
    rm -rf "$data" "$runs"
fi

resume() { [[ -e $1 ]] && echo --resume || true; }

collect() { # folder, scenes, what kind
    cargo run --bin collect -- --randomise --wide --scenes $(($2 / fewer)) --out "$data/$1" $(resume "$data/$1") "${@:3}"
}
train() { # configuration, run, what else
    cargo run --bin train -- --config "configs/$1.toml" --out "$runs/$2" --episodes 0 $few $(resume "$runs/$2") "${@:3}"
}
judge() { # run
    [[ -e $runs/$1/judged ]] || cargo run --bin evaluate -- --weights "$runs/$1/last" --episodes $scenes --out "$runs/$1/shapes.json"
    touch "$runs/$1/judged"
    echo "weights: $runs/$1/last, rates: $runs/$1/shapes.md"
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
for kind in $kinds; do judge "$kind"; done
