/*
 * What answers say of operator tables.
 */
#ifndef SERVER_TABLE_REPLY_H
#define SERVER_TABLE_REPLY_H

struct cJSON;
struct profile;
struct table_report;

/* A profile as documents may give it. */
struct cJSON *table_reply_profile(const struct profile *profile);

/* A table as GET /v1/operators lists it. */
struct cJSON *table_reply_json(const struct table_report *table);

/* Adds a number of few digits, as a measurement deserves. */
void table_reply_add_figure(struct cJSON *json, const char *name,
    double value);

#endif
