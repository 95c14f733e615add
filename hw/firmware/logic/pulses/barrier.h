/* The light barrier: raw edges in, sure ones out. An edge counts when it has lasted; it is dated by itself. */
#ifndef BARRIER_H
#define BARRIER_H

#include "ticks.h"

struct edge { ticks_t tick; int32_t position; uint8_t blocked; };

struct barrier {
    uint8_t raw, sure;      /* level: 1 blocked */
    uint8_t pending;        /* the raw level is not sure yet */
    struct edge edge;       /* when and where it changed */
};

/* Returns the ticks of a bounce if this edge undoes one that had not lasted, else 0. */
uint32_t barrier_edge(struct barrier *barrier, const struct edge *edge);
/* True once when an edge has become sure: barrier->edge and barrier->sure tell which. */
uint8_t barrier_poll(struct barrier *barrier, ticks_t now, uint32_t debounce);

#endif
