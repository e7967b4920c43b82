#!/bin/sh
# Runs wire tests with a tap (tap.mjs) before each daemon, which judges what
# passes by proto/openapi.json, and sums up what it has seen:
#   tests/contract/run.sh PROGRAM...
# The exit status is 0 if all passed, nothing was amiss, and each operation was
# seen to succeed.
log=$(mktemp)
trap 'rm -f "$log"' EXIT
here=$(dirname "$0")

BLOBFIELD_PROXY="node $here/tap.mjs" CONTRACT_LOG=$log tests/run.sh "$@"
status=$?
node "$here/sum.mjs" "$log" || status=1
exit "$status"
