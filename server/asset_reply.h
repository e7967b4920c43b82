/*
 * Answers with compiled-in files.
 */
#ifndef SERVER_ASSET_REPLY_H
#define SERVER_ASSET_REPLY_H

struct asset;
struct exchange;

/*
 * Answers with asset, or 304 by If-None-Match. Browsers are told to ask again
 * each time (the tag is compared), to take the type as it is said, and of pages
 * to load nothing from elsewhere.
 */
void asset_reply(struct exchange *x, const struct asset *asset);

#endif
