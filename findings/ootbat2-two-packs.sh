#!/usr/bin/env bash
# SPDX-License-Identifier: MIT
#
# Believed: ootbat2 warns of a low battery below 10 %, whatever the number of packs.
# Happens:  the percentages of the packs are added: two packs with 6 % each make 12, and no warning comes. With one of 6 % it
#   does. A machine with three packs is warned below 3.4 % of charge.
# Version:  ootbat2 0.1.5 from PyPI, ootbat2/main.py, main(). Its folder of supplies is a variable.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q --disable-pip-version-check ootbat2==0.1.5 playsound3==3.2.8
for supply in one/BAT0 two/BAT0 two/BAT1; do
    mkdir -p "$folder/$supply"
    echo 6 >"$folder/$supply/capacity"
    echo Discharging >"$folder/$supply/status"
done
# One round of its loop; the sound is a word, and no notification is sent.
warning() {
    "$folder/venv/bin/python" - "$1" <<'END'
import logging, sys
logging.disable()
from ootbat2 import main
def stop(seconds):
    raise KeyboardInterrupt
main.path_sysfs_power_supply = sys.argv[1]
main.shutil.which = lambda name: None
main.playsound = lambda file: print('warned', end='')
main.time.sleep = stop
main.main()
END
}
seen="$(warning "$folder/one"), $(warning "$folder/two")"
echo "ootbat2 0.1.5, one pack of 6 %, then two of 6 % each: $seen"
[ "$seen" = "warned, " ]
