#!/bin/sh
# Runs cmocka programs, shows what failed, and counts cases:
#   tests/run.sh PROGRAM...
# The last line is "N passed, N failed"; the exit status is 0 if none failed.
passed=0
failed=0
log=$(mktemp)
trap 'rm -f "$log"' EXIT

for program in "$@"; do
	begin=$(date +%s)
	"$program" >"$log" 2>&1
	status=$?
	ok=$(grep -c '^\[       OK \]' "$log")
	run=$(grep -c '^\[ RUN      \]' "$log")
	bad=$((run - ok))
	# A crash, a leak or a failing set-up counts even if every case was well.
	if [ "$status" -ne 0 ] && [ "$bad" -eq 0 ] || [ "$run" -eq 0 ]; then
		bad=$((bad + 1))
	fi
	passed=$((passed + ok))
	failed=$((failed + bad))
	printf '  %-6s %s: %d of %d, %d s\n' \
		"$([ "$bad" -eq 0 ] && echo ok || echo FAIL)" "${program#build/}" \
		"$ok" "$((ok + bad))" "$(($(date +%s) - begin))"
	# What tests measure is worth reading also when they pass.
	grep '^measured: ' "$log" | sed 's/^measured: /         /'
	[ "$bad" -eq 0 ] || sed 's/^/    /' "$log"
done
printf '%d passed, %d failed\n' "$passed" "$failed"
[ "$failed" -eq 0 ]
