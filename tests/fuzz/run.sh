#!/usr/bin/env bash
# Runs every fuzz target, or those that are named, and ends at the first finding. WEFT_FUZZ_JOBS=N: N of them side by side.
#   tests/fuzz/run.sh BUILD LIBFUZZER_OPTIONS [TARGET...]
# BUILD is that of the preset sanitized. Each target starts from its inputs; new ones are kept in BUILD/corpus. The number of runs counts from there.
set -euo pipefail
build=$1 options=$2
shift 2
root=$(cd "$(dirname -- "${BASH_SOURCE[0]}")/../.." && pwd)
targets=("$@")
if ((${#targets[@]} == 0)); then targets=(task experiment scene obj fabric torchscript plugin_info session dataset model damaged); fi
if ((${#targets[@]} > 1 && ${WEFT_FUZZ_JOBS:-1} > 1)); then
  printf '%s\n' "${targets[@]}" | xargs -P "$WEFT_FUZZ_JOBS" -n 1 "${BASH_SOURCE[0]}" "$build" "$options"
  exit
fi
for target in "${targets[@]}"; do
  mkdir -p "$build/corpus/$target" "$build/found"
  log=$build/found/$target.log
  # shellcheck disable=SC2086
  if ! "$build/bin/weft_fuzz" "$target" $options -artifact_prefix="$build/found/$target-" \
    "$build/corpus/$target" "$root/tests/fuzz/inputs/$target" >"$log" 2>&1; then
    tail -n 80 "$log"
    echo "fuzz target $target: a finding, see $build/found and tests/fuzz/README.md"
    exit 1
  fi
  awk -v target="$target" '/stat::number_of_executed_units/ { runs = $2 } /stat::average_exec_per_sec/ { rate = $2 }
    END { printf "%-12s %d runs, %d/s\n", target, runs, rate }' "$log"
done
