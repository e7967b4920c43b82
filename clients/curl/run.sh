#!/bin/sh
# Starts the daemon, evaluates the example through it, and goes on serving until
# interrupted; with --once, stops it instead:
#   clients/curl/run.sh [--once] DAEMON [FLAG...]
set -eu

once=
if [ "${1-}" = --once ]; then
	once=1
	shift
fi
here=$(dirname "$0")
work=$(mktemp -d)
"$@" >"$work/out" &
daemon=$!
# A terminal's interrupt reaches the daemon too, which finishes what runs.
finish() {
	kill -TERM "$daemon" 2>/dev/null || :
	wait "$daemon" || :
	rm -rf "$work"
}
trap finish EXIT
trap 'exit 130' INT
trap 'exit 143' TERM

# The first line says where it listens.
until grep -q '^blobfieldd listening on ' "$work/out"; do
	if ! kill -0 "$daemon" 2>/dev/null; then
		wait "$daemon" || exit $?
		exit 1
	fi
	sleep 0.05
done
url=$(sed -n 's/^blobfieldd listening on //p;q' "$work/out")
echo "blobfieldd listening on $url"

# Ready once its device is open and its tables are built, or gone.
until curl -sf --noproxy '*' -o /dev/null "$url/readyz"; do
	if ! kill -0 "$daemon" 2>/dev/null; then
		wait "$daemon" || exit $?
		exit 1
	fi
	sleep 0.1
done
BLOBFIELD_URL=$url "$here/example.sh"
if [ -n "$once" ]; then
	kill -TERM "$daemon"
	wait "$daemon"
	exit
fi
echo
echo "Serving on $url: open it in a browser, or try: curl $url/v1/info"
echo "Ctrl-C stops it."
wait "$daemon"
