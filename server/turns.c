#include "server/turns.h"

#include <string.h>

static unsigned long greater(unsigned long a, unsigned long b)
{
	return a > b ? a : b;
}

void turns_add(struct turns *t, struct turn *turn, unsigned long cost)
{
	struct turn **at = &t->first;

	turn->start = t->now;
	for (const struct turn *other = t->first; other != NULL;
	    other = other->next) {
		if (strcmp(other->asker, turn->asker) == 0)
			turn->start = greater(turn->start, other->end);
	}
	turn->end = turn->start + cost;
	while (*at != NULL && (*at)->start <= turn->start)
		at = &(*at)->next;
	turn->next = *at;
	*at = turn;
	t->count++;
}

struct turn *turns_drop(struct turns *t, struct turn **at)
{
	struct turn *turn = *at;

	*at = turn->next;
	t->count--;
	return turn;
}

struct turn *turns_serve(struct turns *t, struct turn **at)
{
	/* That of the first: who passes others by does not make it later. */
	t->now = greater(t->now, t->first->start);
	return turns_drop(t, at);
}

size_t turns_count_of(const struct turns *t, const char *asker)
{
	size_t count = 0;

	for (const struct turn *turn = t->first; turn != NULL;
	    turn = turn->next)
		count += strcmp(turn->asker, asker) == 0;
	return count;
}
