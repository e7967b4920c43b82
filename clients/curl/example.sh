#!/bin/sh
# Evaluates the letter "A" (letter-a.json) at a few points and prints what comes
# back:
#   clients/curl/example.sh
# BLOBFIELD_URL is the daemon's address, http://127.0.0.1:7878 unless set.
# BLOBFIELD_TOKEN, if set, is the token it asks for. Waits up to a
# minute for it to get ready. The exit status is 0 only if all went well.
set -eu

url=${BLOBFIELD_URL:-http://127.0.0.1:7878}
here=$(dirname "$0")
work=$(mktemp -d)
answer=$work/answer
trap 'rm -rf "$work"' EXIT

# In a file, where others do not see it among the processes.
[ -z "${BLOBFIELD_TOKEN:-}" ] ||
	echo "Authorization: Bearer $BLOBFIELD_TOKEN" >"$work/token"
curl() {
	command curl ${BLOBFIELD_TOKEN:+-H "@$work/token"} "$@"
}

tries=0
until curl -sf --noproxy '*' -o /dev/null "$url/readyz"; do
	tries=$((tries + 1))
	if [ "$tries" -ge 300 ]; then
		echo "example.sh: $url does not get ready" >&2
		exit 1
	fi
	sleep 0.2
done

# x y z, one point a line.
points='0 0 2.6
0 0.2 2.3
-0.5 0 1.3
-0.5 -0.2 1.3
0 0 1.4
0 0 0.8
0 0.16 0.8
0 0 0'

list=$(echo "$points" | sed 's/ /,/g; s/.*/[&]/' | paste -sd, -)
status=$(printf '{"scene": %s, "points": [%s]}' \
	"$(cat "$here/letter-a.json")" "$list" |
	curl -s --noproxy '*' -o "$answer" -w '%{http_code}' \
	-H 'Content-Type: application/json' --data-binary @- "$url/v1/eval")
if [ "$status" != 200 ]; then
	echo "example.sh: $url/v1/eval answered $status:" >&2
	cat "$answer" >&2
	echo >&2
	exit 1
fi

echo "Letter A: POST $url/v1/eval"
echo "inside is f > 0.5; the gradient points inward"
echo
# {"count":N,"value":[v,...],"gradient":[[x,y,z],...]} to a table.
echo "$points" >"$work/points"
sed 's/.*"value":\[\([^]]*\)\].*/\1/' "$answer" | tr ',' '\n' >"$work/values"
{ sed 's/.*"gradient":\[\[//; s/\]\].*//; s/\],\[/;/g' "$answer"; echo; } |
	tr ';,' '\n ' >"$work/gradients"
paste -d ' ' "$work/points" "$work/values" "$work/gradients" | awk '
	# No minus before what prints as zero.
	function tidy(x) { return x > -5e-5 && x < 5e-5 ? 0 : x }
	function place(f) {
		if (f > 0.4999 && f < 0.5001)
			return "on the surface"
		return f > 0.5 ? "inside" : "outside"
	}
	NR == 1 {
		printf "%6s %6s %6s %10s %10s %9s %9s\n", "x", "y", "z", "f",
			"df/dx", "df/dy", "df/dz"
	}
	NF == 7 {
		printf "%6.2f %6.2f %6.2f %10.6f %10.4f %9.4f %9.4f  %s\n",
			$1, $2, $3, $4, tidy($5), tidy($6), tidy($7), place($4)
		rows++
	}
	END { exit rows == 0 }'
