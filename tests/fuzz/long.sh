#!/usr/bin/env bash
# Runs fuzz targets in slices until each has had so many executions, and can be stopped and started again.
#   tests/fuzz/long.sh BUILD EXECUTIONS [TARGET...]
# BUILD is that of the preset sanitized. Executions are counted in BUILD/found/executions.txt, one line a slice: time, commit, target,
# executions, per second. The corpus stays in BUILD/corpus. A target ends at its first finding, the others go on.
# Exit code 0: each target has had them all; 1: there was a finding.
set -euo pipefail
build=$1 wanted=$2
shift 2
slice=50000
root=$(cd "$(dirname -- "${BASH_SOURCE[0]}")/../.." && pwd)
targets=("$@")
if ((${#targets[@]} == 0)); then targets=(plugin_info obj fabric torchscript task scene experiment session dataset model damaged); fi
mkdir -p "$build/found"
record=$build/found/executions.txt
touch "$record"
commit=$(git -C "$root" rev-parse --short HEAD)
ended=()
done_so_far() { awk -v target="$1" '$3 == target { runs += $4 } END { print runs + 0 }' "$record"; }
more=1
while ((more)); do
  more=0
  for target in "${targets[@]}"; do
    runs=$(done_so_far "$target")
    if ((runs >= wanted)) || [[ " ${ended[*]} " == *" $target "* ]]; then continue; fi
    more=1
    if ! line=$("$root/tests/fuzz/run.sh" "$build" "-seed=$((runs / slice + 2)) -runs=$slice" "$target"); then
      printf '%s\n' "$line"
      ended+=("$target")
      continue
    fi
    read -r _ executed _ rate <<<"$line"
    printf '%s %s %s %s %s\n' "$(date -u +%Y-%m-%dT%H:%M)" "$commit" "$target" "$executed" "$rate" >>"$record"
  done
done
for target in "${targets[@]}"; do printf '%-12s %d executions\n' "$target" "$(done_so_far "$target")"; done
((${#ended[@]} == 0))
