#!/bin/sh
# Runs cmocka programs, shows what failed, and counts cases:
#   tests/run.sh PROGRAM...
# As many at a time as $TEST_JOBS says (the processors there are), begun in the
# order given, but for what $TEST_LONGEST names (FOLDER/PROGRAM), which is first.
# The last lines are for whoever sees only them: of each program that failed the
# cases that did, in short, and "N passed, N failed", with ", N skipped" if any
# were. The exit status is 0 if none failed. A case that skips itself says why in a
# line "skipped: WHY".

# Lines of a program's log that are shown again, at most.
AGAIN=40

# Of a log, the cases that failed, and what is wrong outside of cases; measured
# lines are worth reading there, too. Of what is long, its beginning and its end.
show_failed() {
	awk '
	/^\[ RUN      \]/ { text = ""; inside = 1 }
	{ text = text $0 "\n" }
	/^\[       OK \]|^\[  SKIPPED \]/ { text = ""; inside = 0 }
	/^\[  FAILED  \]/ && inside { printf "%s", text; text = ""; inside = 0 }
	END { printf "%s", text }' "$1" | awk -v most="$AGAIN" '
	{ line[NR] = $0 }
	END {
		head = NR > most ? int(most / 2) : NR
		for (i = 1; i <= head; i++)
			print "    " line[i]
		if (NR > most)
			printf "    ... %d lines\n", NR - most
		for (i = NR > most ? NR - most + head + 1 : NR + 1; i <= NR; i++)
			print "    " line[i]
	}'
}

# One program: its counts to a file in folder $1, and a block on stdout, written
# at once; if it failed, the short form of that to another file.
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
	head=$(printf '  %-6s %s: %d of %d, %d s' \
		"$([ "$bad" -eq 0 ] && echo ok || echo FAIL)" \
		"${program#build/}" "$ok" "$((ok + bad + skip))" \
		"$(($(date +%s) - begin))")
	{
		echo "$head"
		# What tests measure is worth reading also when they pass.
		sed -n -e 's/^measured: /         /p' \
			-e 's/^skipped: /         &/p' "$log"
		[ "$bad" -eq 0 ] || sed 's/^/    /' "$log"
	} >"$log.block"
	cat "$log.block"
	[ "$bad" -eq 0 ] || {
		echo "$head, status $status"
		show_failed "$log"
	} >"$log.again"
	rm -f "$log" "$log.block"
}

if [ "$1" = --one ]; then
	run_one "$2" "$3"
	exit 0
fi

# $TEST_LONGEST's that are given, in its order, then the others in theirs.
in_order() {
	for program; do
		name=${program#"${program%/*/*}"/}
		place=0
		for long in $TEST_LONGEST; do
			[ "$name" != "$long" ] || break
			place=$((place + 1))
		done
		echo "$place $program"
	done | sort -s -n -k 1,1 | cut -d ' ' -f 2-
}

# Has the built-in tables in a folder that all tests' daemons read: each would
# take one or two seconds to build them. Without it they do.
build_tables() {
	for program; do
		daemon=${BLOBFIELDD:-${program%%/tests/*}/blobfieldd}
		[ ! -x "$daemon" ] || break
	done
	[ -x "$daemon" ] && [ $# -gt 1 ] || return
	"$daemon" --listen 127.0.0.1:0 --data :memory: --quiet --no-measure \
		--cache "$folder/cache" >"$folder/daemon.log" 2>&1 &
	for _ in $(seq 600); do
		[ "$(find "$folder/cache" -name 'figures-*.blobcache' \
			2>/dev/null | wc -l)" -lt 4 ] || break
		sleep 0.1
	done
	kill "$!"
	wait "$!" && export BLOBFIELD_TEST_CACHE="$folder/cache"
}

folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
build_tables "$@"
in_order "$@" |
	xargs -n 1 -P "${TEST_JOBS:-$(($(nproc) + 1))}" "$0" --one "$folder"

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
[ "$failed" -eq 0 ] || {
	echo
	echo "what failed, in short:"
	find "$folder" -name '*.again' -exec cat {} +
	[ "$missing" -eq 0 ] || echo "  $missing have not ended"
	echo
}
printf '%d passed, %d failed' "$passed" "$failed"
[ "$skipped" -eq 0 ] || printf ', %d skipped' "$skipped"
echo
[ "$failed" -eq 0 ]
