#!/bin/sh
# Loads the daemon by wrk, and by hey if that is there, and shows what they
# measure:
#   clients/curl/load.sh [SECONDS [CONNECTIONS]]
# 5 s and 32 connections unless said: of each of three loads,
#   small    256 points of the letter A, raw float32 both ways
#   json     16 points, JSON both ways
#   mixed    all that a previewer asks: values, rays, projections, bounds,
#            slices, pictures, small meshes, and the document put anew
# BLOBFIELD_URL is the daemon's address, http://127.0.0.1:7878 unless set.
# BLOBFIELD_TOKEN, if set, is the token it asks for. Leaves no
# scene behind. The exit status is 0 unless something failed; 503 for want of room
# is counted apart.
set -eu

url=${BLOBFIELD_URL:-http://127.0.0.1:7878}
seconds=${1:-5}
connections=${2:-32}
here=$(dirname "$0")
id="load-$$"
work=$(mktemp -d)
# In a file, where others do not see it among the processes.
[ -z "${BLOBFIELD_TOKEN:-}" ] ||
	echo "Authorization: Bearer $BLOBFIELD_TOKEN" >"$work/token"
curl() {
	command curl ${BLOBFIELD_TOKEN:+-H "@$work/token"} "$@"
}
finish() {
	curl -s --noproxy '*' -X DELETE -o /dev/null "$url/v1/scenes/$id" || :
	rm -rf "$work"
}
trap finish EXIT
trap 'exit 130' INT
trap 'exit 143' TERM
failed=0

if ! command -v wrk >/dev/null; then
	echo "load.sh: there is no wrk; on Debian: apt install wrk" >&2
	exit 1
fi
curl -sf --noproxy '*' -X PUT -o /dev/null -H 'Content-Type: application/json' \
	--data-binary "@$here/letter-a.json" "$url/v1/scenes/$id"
# 256 points: (0,0,0), which is as good as any.
head -c 3072 /dev/zero >"$work/points"

# load NAME: wrk with load.lua, which makes that load's requests.
load() {
	echo "== $1: $connections connections, $seconds s"
	SCENE=$id LOAD=$1 DOCUMENT=$here/letter-a.json POINTS=$work/points \
		wrk -t 2 -c "$connections" -d "${seconds}s" --latency --timeout 10s \
		-s "$here/load.lua" "$url" | tee "$work/out"
	# wrk's own status does not say.
	if ! grep -q '^requests that succeeded: [1-9]' "$work/out" ||
	    grep -qE 'Socket errors|failed: [1-9]' "$work/out"; then
		echo "load.sh: something failed" >&2
		failed=1
	fi
	echo
}

load small
load json
load mixed
if command -v hey >/dev/null; then
	echo "== small, by hey"
	hey -z "${seconds}s" -c "$connections" -m POST \
		${BLOBFIELD_TOKEN:+-H "Authorization: Bearer $BLOBFIELD_TOKEN"} \
		-T application/octet-stream -H 'Accept: application/octet-stream' \
		-D "$work/points" "$url/v1/scenes/$id/eval" | tee "$work/out"
	if grep -E '^ +\[[0-9]+\]' "$work/out" | grep -qv '\[200\]'; then
		failed=1
	fi
fi
exit "$failed"
