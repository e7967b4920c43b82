#!/bin/sh
# Calls each endpoint once and shows the first of what it answers:
#   clients/curl/every-endpoint.sh
# BLOBFIELD_URL is the daemon's address, http://127.0.0.1:7878 unless set.
# BLOBFIELD_TOKEN, if set, is the token it asks for, of the role admin. Leaves no
# scene behind. The exit status is 0 only if every status was the expected one.
set -u

url=${BLOBFIELD_URL:-http://127.0.0.1:7878}
here=$(dirname "$0")
json='Content-Type: application/json'
octets='Content-Type: application/octet-stream'
id="every-endpoint-$$"
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
failed=0

# In a file, where others do not see it among the processes.
[ -z "${BLOBFIELD_TOKEN:-}" ] ||
	echo "Authorization: Bearer $BLOBFIELD_TOKEN" >"$work/token"
curl() {
	command curl ${BLOBFIELD_TOKEN:+-H "@$work/token"} "$@"
}

# call STATUS METHOD PATH [curl arguments]: one request, which must answer STATUS.
call() {
	expected=$1 method=$2 path=$3
	shift 3
	: >"$work/body"
	status=$(curl -s --noproxy '*' -X "$method" -D "$work/headers" \
		-o "$work/body" -w '%{http_code}' "$@" "$url$path")
	echo "$method $path -> $status"
	head -c 300 "$work/body" | tr -c '[:print:]\n' '.' | head -n 3
	echo
	if [ "$status" != "$expected" ]; then
		echo "  expected $expected" >&2
		failed=1
	fi
}

# header NAME: the last answer's header.
header() {
	tr -d '\r' <"$work/headers" | sed -n "s/^$1: //ip"
}

# How far a mesh of many cells is, while it is made; which may be over before.
progress() {
	token="progress-$$"
	curl -s --noproxy '*' -H "$json" -d '{"resolution": 256}' -o /dev/null \
		"$url/v1/scenes/$id/mesh?progress=$token" &
	made=$!
	while kill -0 "$made" 2>/dev/null; do
		sleep 0.1
		status=$(curl -s --noproxy '*' -o "$work/body" -w '%{http_code}' \
			"$url/v1/progress/$token")
		[ "$status" != 200 ] || break
	done
	echo "GET /v1/progress/$token -> $status"
	cat "$work/body"
	echo
	wait "$made" || failed=1
}

# The scene's events, until it is deleted.
listen() {
	curl -sN --noproxy '*' -o "$work/events" -w '%{http_code}' \
		"$url/v1/scenes/$id/events" >"$work/status" &
	listener=$!
	while kill -0 "$listener" 2>/dev/null &&
		! grep -qs '^event: revision' "$work/events"; do
		sleep 0.1
	done
}

heard() {
	wait "$listener" || failed=1
	echo "GET /v1/scenes/$id/events -> $(cat "$work/status")"
	cat "$work/events"
	grep -q '^event: deleted' "$work/events" || failed=1
}

printf '{"scene": %s, "points": [[0,0,2.6], [0,0,1.4]]}' \
	"$(cat "$here/letter-a.json")" >"$work/eval.json"
# Two points as raw float32: (0,0,0) and (0,0,2).
printf '\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\100' >"$work/points"

# A grid of 4 x 4 x 4 float32, all 0, as NumPy writes it.
{
	header="{'descr': '<f4', 'fortran_order': False, 'shape': (4, 4, 4), }"
	printf '\223NUMPY\1\0\166\0%-117s\n' "$header"
	head -c 256 /dev/zero
} >"$work/grid.npy"
cat >"$work/import.json" <<'END'
{"type": "RootNode", "children": [{"type": "ScalisPoint", "density": 1,
  "volType": "dist", "v": [{"position": {"x": 0, "y": 0, "z": 0}, "thickness": 1}],
  "materials": [{"color": "#ff8000"}]}]}
END

# A ray and a point as raw float32: from (0,-5,0) along (0,1,0); (0,0,2).
printf '\0\0\0\0\0\0\240\300\0\0\0\0\0\0\0\0\0\0\200\77\0\0\0\0' >"$work/ray"

call 200 GET /
call 200 GET / -H 'Accept: text/html'
call 200 GET /web/app.js
call 200 GET /openapi.json
call 200 GET /healthz
call 200 GET /readyz
call 200 GET /metrics
call 200 GET /v1/info
call 200 GET /v1/tokens
call 200 GET /v1/operators
call 200 GET /v1/operators/camel
call 200 POST /v1/operators -H "$json" \
	-d '{"profile": "circle", "max_error": 1e-3}'
call 200 POST /v1/eval -H "$json" --data-binary "@$work/eval.json"
call 201 PUT "/v1/scenes/$id" -H "$json" --data-binary "@$here/letter-a.json"
tag=$(header ETag)
call 200 GET "/v1/scenes?limit=10"
call 200 GET "/v1/scenes/$id"
call 304 GET "/v1/scenes/$id" -H "If-None-Match: $tag"
call 200 PUT "/v1/scenes/$id" -H "$json" -H "If-Match: $tag" \
	--data-binary "@$here/letter-a.json"
call 200 PATCH "/v1/scenes/$id" -H "If-Match: $tag" \
	-H 'Content-Type: application/json-patch+json' \
	-d '[{"op": "add", "path": "/name", "value": "a new name"}]'
call 200 PATCH "/v1/scenes/$id" \
	-H 'Content-Type: application/merge-patch+json' -d '{"name": null}'
call 200 GET "/v1/scenes/$id/revisions?limit=2"
call 200 GET "/v1/scenes/$id?revision=$(echo "$tag" | tr -d '"')"
call 200 POST "/v1/scenes/$id/eval" -H "$json" \
	-d '{"points": [0,0,2.6], "outputs": ["value", "gradient", "hessian"]}'
call 200 POST "/v1/scenes/$id/eval?outputs=value&deadline=60" -H "$octets" \
	-H 'Accept: application/x-npy' --data-binary "@$work/points"
call 200 POST "/v1/scenes/$id/grid" -H "$json" \
	-d '{"min": [-1,0,0], "max": [1,0,2.6], "counts": [3,1,5]}'
call 200 POST "/v1/scenes/$id/grid?outputs=value" -H "$json" \
	-H 'Accept: application/x-npy' \
	-d '{"min": [-1,-0.5,0], "max": [1,0.5,3], "counts": [8,4,12]}'
call 200 GET "/v1/scenes/$id/bounds"
call 200 POST "/v1/scenes/$id/opening-angle" -H "$json" \
	-d '{"node": "letter", "point": [0.1, 0, 2.4]}'
call 200 POST "/v1/scenes/$id/raycast" -H "$json" \
	-d '{"rays": [[0,-5,2.5, 0,1,0], [0,-5,-3, 0,1,0]]}'
call 200 POST "/v1/scenes/$id/raycast?iso=0.3" -H "$octets" \
	-H 'Accept: application/x-npy' --data-binary "@$work/ray"
call 200 POST "/v1/scenes/$id/project" -H "$json" \
	-d '{"points": [[0.5,0.25,1.4]], "max_distance": 2}'
call 200 POST "/v1/scenes/$id/render" -H "$json" \
	-d '{"width": 64, "height": 48, "shading": "normal", "samples": 1,
	"camera": {"eye": [1,-6,3], "target": [0,0,1.3]}}'
call 200 POST "/v1/scenes/$id/slice" -H "$json" \
	-d '{"width": 64, "height": 64, "levels": {"step": 0.1}}'
call 200 POST "/v1/scenes/$id/slice" -H "$json" \
	-H 'Accept: application/x-npy' -d '{"width": 8, "height": 8}'
for format in glb ply stl obj json; do
	call 200 POST "/v1/scenes/$id/mesh?format=$format" -H "$json" \
		-d '{"resolution": 24}'
done
progress
listen
call 204 DELETE "/v1/scenes/$id"
heard
call 201 POST "/v1/volumes?min=0,0,0&max=3,3,3&kind=field" \
	-H 'Content-Type: application/x-npy' --data-binary "@$work/grid.npy"
volume=$(header Location)
call 200 GET /v1/volumes
call 200 GET "$volume"
call 204 DELETE "$volume"
call 200 POST /v1/import -H "$json" --data-binary "@$work/import.json"
call 201 POST /v1/scenes -H "$json" --data-binary "@$here/letter-a.json"
call 204 DELETE "$(header Location)"
call 204 OPTIONS /v1/eval
exit "$failed"
