#!/bin/sh
# Runs the fuzzers, one after another:
#   tests/fuzz/run.sh BUILD SECONDS [NAME]...
# BUILD is where they were built (build), SECONDS how long each runs: 0 gives each
# the inputs that are kept, and nothing else. NAMEs: http, points...; none: all.
# What they find on their way stays in BUILD/corpus. Prints what each has done,
# and the sum; ends with the first defect, whose input is in BUILD/corpus/found.
set -eu

here=$(dirname "$0")
build=$1
seconds=$2
shift 2
[ $# -gt 0 ] || set -- $(ls "$here" | sed -n 's/^fuzz_\(.*\)\.c$/\1/p')

mkdir -p "$build/corpus/found"
if [ "$seconds" -gt 0 ]; then
	limit=-max_total_time=$seconds
else
	limit=-runs=0
fi
log=$build/corpus/log
total=0
trap 'rm -f "$log"' EXIT

number() {
	sed -n "s/^stat::$1: *//p" "$log"
}

printf '%-14s %12s %8s %8s %8s\n' fuzzer executions seconds inputs edges
for name in "$@"; do
	own=$build/corpus/fuzz_$name
	more=
	mkdir -p "$own"
	[ ! -f "$here/$name.dict" ] || more=-dict=$here/$name.dict
	# Threads of a daemon that goes on have what looks like leaks.
	[ "$name" != http ] || more="$more -detect_leaks=0"
	begin=$(date +%s)
	if ! "$build/fuzz/fuzz_$name" "$limit" $more -max_len=8192 \
	    -rss_limit_mb=4096 -timeout=120 -close_fd_mask=2 \
	    -print_final_stats=1 -artifact_prefix="$build/corpus/found/$name-" \
	    "$own" "$here/corpus/$name" >"$log" 2>&1; then
		tail -n 60 "$log"
		echo "fuzz_$name has found a defect" >&2
		exit 1
	fi
	count=$(number number_of_executed_units)
	total=$((total + count))
	printf '%-14s %12d %8d %8d %8d\n' "$name" "$count" \
	    $(($(date +%s) - begin)) "$(find "$here/corpus/$name" "$own" -type f | wc -l)" \
	    "$(sed -n 's/.* cov: \([0-9]*\).*/\1/p' "$log" | tail -n 1)"
done
echo "total: $total executions"
