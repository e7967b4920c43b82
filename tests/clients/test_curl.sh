#!/bin/sh
# The curl scripts against a real daemon: each runs to its end, every-endpoint.sh
# calls each endpoint that GET / lists, and none leaves a scene behind. Prints its
# cases as cmocka does. In the environment: BLOBFIELDD.
set -u

daemon=${BLOBFIELDD:-build/blobfieldd}
work=$(mktemp -d)
"$daemon" --listen 127.0.0.1:0 --quiet --no-measure --no-cache --data :memory: >"$work/first" &
pid=$!
trap 'kill "$pid" 2>/dev/null; rm -rf "$work"' EXIT
failed=0

tries=0
until [ -s "$work/first" ] || [ "$tries" -ge 100 ]; do
	tries=$((tries + 1))
	sleep 0.1
done
BLOBFIELD_URL=$(sed -n 's/^blobfieldd listening on //p;q' "$work/first")
export BLOBFIELD_URL

# run NAME COMMAND...: a case, which is good if the command is.
run() {
	name=$1
	shift
	echo "[ RUN      ] $name"
	if "$@" >"$work/out" 2>&1; then
		echo "[       OK ] $name"
	else
		cat "$work/out"
		echo "[  FAILED  ] $name"
		failed=1
	fi
	sed -n 's/^Requests\/sec: */measured: requests a second /p' "$work/out"
}

example() {
	clients/curl/example.sh && clients/curl/example.sh |
		grep -q '0.16   0.80   0.500000 .*on the surface'
}

every_endpoint() {
	clients/curl/every-endpoint.sh >"$work/calls" 2>&1 ||
		{ cat "$work/calls"; return 1; }
}

# "METHOD PATH", ids and queries left out, of each call; progress has a token.
each_is_called() {
	sed -n 's/^\([A-Z]*\) \([^ ?]*\).* -> .*/\1 \2/p' "$work/calls" |
		sed -E 's#(/v1/(scenes|operators|volumes|progress)|/web)/[^/]+#\1/{id}#' |
		sort -u >"$work/called"
	curl -s --noproxy '*' "$BLOBFIELD_URL/" | sed 's/"method"/\n&/g' |
		sed -n 's/^"method":"\([A-Z]*\)","path":"\([^"]*\).*/\1 \2/p' |
		sort -u >"$work/listed"
	[ -s "$work/listed" ] && missing=$(comm -23 "$work/listed" \
		"$work/called") && [ -z "$missing" ] ||
		{ echo "not called: $missing"; return 1; }
}

nothing_is_left() {
	curl -s --noproxy '*' "$BLOBFIELD_URL/v1/scenes" | tee "$work/scenes" |
		grep -qx '{"scenes":\[\]}' || { cat "$work/scenes"; return 1; }
}

run test_example_finds_the_surface example
run test_every_endpoint_answers every_endpoint
run test_every_endpoint_of_the_index_is_called each_is_called
if command -v wrk >/dev/null; then
	run test_load_fails_nothing clients/curl/load.sh 1 8
else
	echo 'skipped: test_load_fails_nothing: there is no wrk'
fi
run test_nothing_is_left_behind nothing_is_left

kill -TERM "$pid"
wait "$pid" || failed=1
exit "$failed"
