#!/bin/sh
# Runs test_addon.py in Blender, without the user's settings.
here=$(dirname "$0")
settings=$(mktemp -d)
trap 'rm -rf "$settings"' EXIT
BLENDER_USER_CONFIG="$settings/config" \
BLENDER_USER_SCRIPTS="$settings/scripts" \
PYTHONDONTWRITEBYTECODE=1 "${BLENDER:-blender}" --background --factory-startup \
    --python "$here/test_addon.py"
