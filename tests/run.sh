#!/bin/sh
# Runs cmocka programs, shows what failed, and counts cases:
#   tests/run.sh PROGRAM...
# As many at a time as $TEST_JOBS says (the processors there are). The last line
# is "N passed, N failed", and ", N skipped" if any were; the exit status is 0 if
# none failed. A case that skips itself says why in a line "skipped: WHY".

# One program: its counts to a file in folder $1, and a block on stdout, written
# at once.
run_one() {
	folder=$1
	program=$2
	log=$(mktemp "$folder/log.XXXXXX")
	begin=$(date +%s)
	"$program" >"$log" 2>&1 </dev/null
	status=$?
	ok=$(grep -c '^\[       OK \]' "$log")
	run=$(grep -c '^\[ RUN      \]' "$log")
	# cmocka lists them once more below its sum.
	skip=$(grep -x '\[  SKIPPED \] [a-z0-9_]*' "$log" | sort -u | wc -l)
	bad=$((run - ok - skip))
	# What goes wrong outside of the cases counts as one: a crash, no cases, a
	# group's set-up or teardown (cmocka's status leaves it out), a sanitizer's
	# report, also if by a daemon whose status nobody asks for.
	if [ "$bad" -eq 0 ] && { [ "$status" -ne 0 ] || [ "$run" -eq 0 ] ||
	    grep -qE '^\[  FAILED  \] GROUP|Sanitizer: |: runtime error: ' \
		"$log"; }; then
		bad=1
	fi
	echo "$ok $bad $skip" >"$log.count"
	{
		printf '  %-6s %s: %d of %d, %d s\n' \
			"$([ "$bad" -eq 0 ] && echo ok || echo FAIL)" \
			"${program#build/}" "$ok" "$((ok + bad + skip))" \
			"$(($(date +%s) - begin))"
		# What tests measure is worth reading also when they pass.
		sed -n -e 's/^measured: /         /p' \
			-e 's/^skipped: /         &/p' "$log"
		[ "$bad" -eq 0 ] || sed 's/^/    /' "$log"
	} >"$log.block"
	cat "$log.block"
	rm -f "$log" "$log.block"
}

if [ "$1" = --one ]; then
	run_one "$2" "$3"
	exit 0
fi

folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
printf '%s\n' "$@" |
	xargs -n 1 -P "${TEST_JOBS:-$(nproc)}" "$0" --one "$folder"

passed=0
failed=0
skipped=0
for count in "$folder"/*.count; do
	read -r ok bad skip <"$count"
	passed=$((passed + ok))
	failed=$((failed + bad))
	skipped=$((skipped + skip))
done
# One that did not even get to count has failed.
missing=$(($# - $(find "$folder" -name '*.count' | wc -l)))
failed=$((failed + missing))
printf '%d passed, %d failed' "$passed" "$failed"
[ "$skipped" -eq 0 ] || printf ', %d skipped' "$skipped"
echo
[ "$failed" -eq 0 ]
