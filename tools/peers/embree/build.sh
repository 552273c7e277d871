#!/bin/sh
# Builds `occluded` beside this script: with Embree 4 from PyPI's wheel where that can be had, else with the
# system's Embree 3, whose headers both need.
set -e
cd "$(dirname "$0")"
if [ ! -d wheel ] && pip download --quiet embreex==4.4.0.post1 --no-deps -d wheel; then
    unzip -q wheel/*.whl -d wheel
fi
library=$(ls wheel/embreex.libs/libembree4-*.so.4 2>/dev/null) &&
    c++ -std=c++17 -O2 -DEMBREE_4 -o occluded occluded.cpp "$library" \
        -Wl,-rpath,"$PWD/wheel/embreex.libs" -pthread ||
    c++ -std=c++17 -O2 -o occluded occluded.cpp -lembree3 -pthread
