#!/bin/sh
# The whole flow on a sample meadow: site, classes, scoremap, plan, missions, pictures. Called by `make demo`.
set -eu
demo=${DEMO:-demo}
hrt synth "$demo/site" --scene meadow --size 60 --seed 1 --overwrite
hrt init "$demo" --overwrite
# What an operator would write after a look at classes.png: how well the robot drives on each class.
cp fixtures/demo-scores.json "$demo/scores.json"
make --no-print-directory -C "$demo" ortho=site/ortho.tif classes=6 scores=scores.json no_go_below=0.2 no_go_share= margin_m= budget=400
echo
hrt evaluate plan "$demo/out/scoremap.tif" "$demo/out/plan.json" --figure "$demo/out/rewards.png" --overwrite
echo
# A simulated robot drives the plan; what its camera sees is kept for the report.
hrt drive "$demo/out/plan.json" --world "$demo/site" -o "$demo/out/drive.jsonl" --record "$demo/out/frames" --overwrite
hrt evaluate segment "$demo/out/classes.tif" "$demo/site/truth.tif" --json > "$demo/out/agreement.json"
hrt report "$demo" -o "$demo/report.html" --overwrite
echo
echo "Report:   $demo/report.html (open it in a browser)"
echo "Pictures: $demo/out/classes.png $demo/out/scoremap.png $demo/out/plan.png $demo/out/rewards.png"
echo "Missions: $demo/out/mission.plan (QGroundControl) mission.waypoints mission.gpx mission.kml mission.geojson mission.csv nav2/"
classes=$(hrt evaluate segment "$demo/out/classes.tif" "$demo/site/truth.tif")
plan=$(hrt evaluate plan "$demo/out/scoremap.tif" "$demo/out/plan.json" --no-planner | sed -n 1p)
echo "Figures:  $classes; $plan"
