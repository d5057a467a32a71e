#!/usr/bin/env bash
# Picks up a box and hands it over while somebody leans on the robot. Needs a running robot:
#     mocad --config examples/hand-over/robot.toml
# Somebody takes the box, then presses Enter here. MOCAD names another program, ADDRESS another robot; words behind the script go to
# every target.
set -euo pipefail
mocad() { command "${MOCAD:-mocad}" "$@" ${ADDRESS:+--address "$ADDRESS"}; }
# Leads the flange to x, y, z m. A touch sets the target aside and does not end it.
go() { mocad target pose "$@" --touch pass-through; }

go 0.70 0.00 1.05 "$@"              # above the box
go 0.70 0.00 0.9034 "$@"            # the fingertips are 0.1034 m beyond the flange
mocad gripper grasp 0.05 --force 40 --mass 0.5 || { echo "nothing was grasped: look where the box is" >&2; exit 1; }
go 0.70 0.00 1.05 "$@"              # lifted: the law carries the 0.5 kg that it was told
go 0.65 -0.30 1.00 "$@"             # in front of the person
read -r -p "Take the box, then press Enter. "
mocad gripper release
go 0.507 0.00 1.10 "$@"             # back
