#!/bin/sh
# Two sample missions from end to end: `sh missions.sh wildfire` and `sh missions.sh reef` (see `make missions`).
set -eu
mission=${1:?wildfire or reef}
out=${MISSIONS:-missions}/$mission
here=$(cd "$(dirname "$0")" && pwd)
mkdir -p "$out"

wildfire() {
  # A crew has burnt ground surveyed in colour and in heat; a ground robot is to look at what still smoulders.
  hrt synth "$out/site" --scene wildfire --size 60 --pixel 0.1 --seed 2
  hrt segment "$out/site/ortho.tif" -o "$out/classes.tif" --classes 8 --figure "$out/classes.png"
  # A first drive, wherever it leads, teaches which ground is good and which is not.
  hrt scoremap "$out/classes.tif" -o "$out/flat.tif"
  hrt plan "$out/flat.tif" -o "$out/scout-plan.json" --start auto --budget 4min --seed 1
  hrt drive "$out/scout-plan.json" --world "$out/site" -o "$out/scout.jsonl"
  hrt feedback "$out/scout.jsonl" --classes "$out/classes.tif" -o "$out/scores.json" --dsm "$out/site/dsm.tif"
  # Then only heat counts: nothing below 45 degrees Celsius, all of it from 90 on. It is seen from 2 m, so that each spot
  # counts at one cell. The heights tell what is too steep or too rough, also where a class does not.
  hrt scoremap "$out/classes.tif" -o "$out/scoremap.tif" --scores "$out/scores.json" --no-go-below 0.2 \
    --no-go-share 0.3 --dsm "$out/site/dsm.tif" --interest "$out/site/thermal.tif" --thermal-units auto \
    --interest-range 45,90 --interest-radius 2 \
    --figure "$out/scoremap.png" --backdrop "$out/site/ortho.tif"
  hrt plan "$out/scoremap.tif" -o "$out/plan.json" --visited "$out/scout.jsonl" --budget 300m \
    --figure "$out/plan.png" --backdrop "$out/site/ortho.tif"
  hrt export "$out/plan.json" --format qgc -o "$out/mission.plan"
  hrt drive "$out/plan.json" --world "$out/site" -o "$out/drive.jsonl" --local expert --after "$out/scout.jsonl"
  hrt evaluate drive "$out/drive.jsonl" --world "$out/site" --scoremap "$out/scoremap.tif" --figure "$out/drive.png"
}

reef() {
  # An underwater robot is to photograph the coral of a reef, a metre above it.
  hrt synth "$out/site" --scene reef --size 100 --pixel 0.1 --seed 3
  hrt segment "$out/site/ortho.tif" -o "$out/classes.tif" --classes 6 --figure "$out/classes.png"
  # What a biologist would write after a look at classes.png: class 2 is coral.
  cp "$here/coral.json" "$out/coral.json"
  hrt scoremap "$out/classes.tif" -o "$out/scoremap.tif" --scores "$out/coral.json"
  hrt plan "$out/scoremap.tif" -o "$out/plan.json" --start auto --budget 1400m --speed 0.5 \
    --figure "$out/plan.png" --backdrop "$out/site/ortho.tif"
  hrt export "$out/plan.json" --vehicle submarine --format qgc -o "$out/mission.plan"
  hrt drive "$out/plan.json" --world "$out/site" -o "$out/drive.jsonl" --local expert
  hrt evaluate drive "$out/drive.jsonl" --world "$out/site" --scoremap "$out/scoremap.tif" --figure "$out/drive.png" \
    --require collisions==0
}

"$mission"
hrt report "$out" -o "$out/report.html"
