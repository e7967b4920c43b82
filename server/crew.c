#include "server/crew.h"

#include <pthread.h>
#include <stdatomic.h>
#include <unistd.h>

#define CREW_MAX 64

struct crew {
	size_t count;
	bool (*piece)(void *ctx, size_t i);
	void *ctx;
	atomic_size_t next;
	atomic_bool refused;
};

static void *work(void *arg)
{
	struct crew *crew = arg;

	while (!atomic_load(&crew->refused)) {
		size_t i = atomic_fetch_add(&crew->next, 1);

		if (i >= crew->count)
			break;
		if (!crew->piece(crew->ctx, i))
			atomic_store(&crew->refused, true);
	}
	return NULL;
}

bool crew_run(size_t count, bool (*piece)(void *ctx, size_t i), void *ctx)
{
	struct crew crew = {count, piece, ctx, 0, false};
	pthread_t threads[CREW_MAX];
	long cores = sysconf(_SC_NPROCESSORS_ONLN);
	int n = 0;

	while (n < CREW_MAX && n + 1 < cores &&
	    pthread_create(&threads[n], NULL, work, &crew) == 0)
		n++;
	work(&crew);
	while (n > 0)
		pthread_join(threads[--n], NULL);
	return !atomic_load(&crew.refused);
}
