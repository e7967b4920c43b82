#!/bin/sh
# What debian/ takes from the repository: fill.sh VERSION FOLDER, at the root.
set -e
version=$1
folder=$2

{
	echo "blobfield ($version-1) unstable; urgency=medium"
	echo
	echo "  * See /usr/share/doc/blobfield/CHANGELOG.md."
	echo
	echo " -- The blobfield authors <blobfield@localhost>  $(
	    date -R -r CHANGELOG.md)"
} > "$folder/changelog"

# As DEP 5 wants it: the text indented, blank lines as dots.
awk '/^@LICENSE@$/ {
	while ((getline line < "LICENSE") > 0)
		if (++n > 4)
			print line == "" ? " ." : " " line
	next
}
/^@COPYRIGHT@$/ {
	while ((getline line < "LICENSE") > 0)
		if (line ~ /^Copyright/)
			print "Copyright: " substr(line, 15)
	close("LICENSE")
	next
}
{ print }' "$folder/copyright" > "$folder/copyright.part"
mv "$folder/copyright.part" "$folder/copyright"
rm -f "$folder/fill.sh"
