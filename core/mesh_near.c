/*
 * Where the cells and edges beside a cell are.
 */
#include "core/mesh_work.h"

#define SIDE CELLS_SIDE

void mesh_near_init(const struct mesh_work *w, const struct mesh_block *b,
    int step, struct mesh_near *out)
{
	for (size_t i = 0; i < 8; i++) {
		size_t s = (size_t)step;

		out->blocks[i] = mesh_block_at(w, b->at[0] + (i & 1 ? s : 0),
		    b->at[1] + (i & 2 ? s : 0), b->at[2] + (i & 4 ? s : 0));
	}
}

/* Takes a step along axis a within local; whether it leaves the block, on the
 * other side of the next one. */
static inline unsigned step_up(unsigned *local, unsigned a)
{
	if ((*local >> 2 * a & 3) == SIDE - 1) {
		*local &= ~(3u << 2 * a);
		return 1u << a;
	}
	*local += 1u << 2 * a;
	return 0;
}

static inline unsigned step_down(unsigned *local, unsigned a)
{
	if ((*local >> 2 * a & 3) == 0) {
		*local |= 3u << 2 * a;
		return 1u << a;
	}
	*local -= 1u << 2 * a;
	return 0;
}

uint32_t mesh_cell_crossing(const struct mesh_near *near, unsigned local,
    unsigned edge)
{
	unsigned a = edge / 4, beyond = 0;

	if (edge & 1)
		beyond |= step_up(&local, (a + 1) % 3);
	if (edge & 2)
		beyond |= step_up(&local, (a + 2) % 3);
	return mesh_crossing_of(near->blocks[beyond], a, local);
}

uint32_t mesh_cell_below(const struct mesh_near *near, unsigned local,
    unsigned down)
{
	unsigned beyond = 0;

	for (unsigned a = 0; a < 3; a++)
		if (down >> a & 1)
			beyond |= step_down(&local, a);
	return mesh_cell_of(near->blocks[beyond], local);
}

uint32_t mesh_cell_above(const struct mesh_near *near, unsigned local,
    unsigned a)
{
	unsigned beyond = step_up(&local, a);

	return mesh_cell_of(near->blocks[beyond], local);
}
