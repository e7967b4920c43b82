/*
 * Lists that a job lies in: links within the job itself, so that it leaves any
 * of them at once and without memory.
 */
#ifndef SERVER_JOB_LIST_H
#define SERVER_JOB_LIST_H

struct job;

enum job_order {
	JOB_BY_AGE,  /* all that wait, the one served longest ago first */
	JOB_BY_TURN, /* those that take turns with each other, or are stalled */
	JOB_ORDER_COUNT
};

struct job_link {
	struct job *prev, *next;
};

struct job_list {
	struct job *first, *last;
};

#endif
