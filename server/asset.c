#include "server/asset.h"

#include <pthread.h>
#include <string.h>

#include "server/etag.h"

/* What ld -b binary makes of a file. */
#define EMBEDDED(symbol) \
	extern const char _binary_##symbol##_start[], _binary_##symbol##_end[]

EMBEDDED(clients_web_dist_index_html);
EMBEDDED(clients_web_dist_app_js);
EMBEDDED(clients_web_dist_app_css);
EMBEDDED(proto_openapi_json);

static const struct {
	const char *name;
	enum media_type type;
	const char *start, *end;
} files[] = {
#define FILE_OF(name, type, symbol) \
	{name, type, _binary_##symbol##_start, _binary_##symbol##_end}
	FILE_OF("index.html", MEDIA_HTML, clients_web_dist_index_html),
	FILE_OF("app.js", MEDIA_SCRIPT, clients_web_dist_app_js),
	FILE_OF("app.css", MEDIA_STYLE, clients_web_dist_app_css),
	FILE_OF("openapi.json", MEDIA_JSON, proto_openapi_json),
};

#define FILE_COUNT (sizeof files / sizeof *files)

/* Made once, by the first that asks. */
static char etags[FILE_COUNT][ETAG_SIZE];
static pthread_once_t etags_made = PTHREAD_ONCE_INIT;

static size_t file_length(size_t i)
{
	return (size_t)(files[i].end - files[i].start);
}

static void make_etags(void)
{
	for (size_t i = 0; i < FILE_COUNT; i++)
		etag_of(files[i].start, file_length(i), etags[i]);
}

bool asset_find(const char *name, struct asset *out)
{
	pthread_once(&etags_made, make_etags);
	for (size_t i = 0; i < FILE_COUNT; i++) {
		if (strcmp(files[i].name, name) != 0)
			continue;
		*out = (struct asset){files[i].name, files[i].type,
		    files[i].start, file_length(i), etags[i]};
		return true;
	}
	return false;
}
