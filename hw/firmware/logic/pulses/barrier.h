/* Debouncing of the light barrier. An edge is confirmed when its level has lasted; it keeps its own time. */
#ifndef BARRIER_H
#define BARRIER_H

#include "ticks.h"

struct edge { ticks_t tick; int32_t position; uint8_t blocked; };

struct barrier {
    uint8_t raw, confirmed;      /* level: 1 blocked */
    uint8_t pending;        /* the raw level is not confirmed yet */
    struct edge edge;       /* when and where it changed */
};

/* Takes a raw edge. Returns the duration of a bounce if it undoes an unconfirmed edge, else 0. */
uint32_t barrier_edge(struct barrier *barrier, const struct edge *edge);
/* True once when an edge is confirmed; it is in barrier->edge and barrier->confirmed. */
uint8_t barrier_poll(struct barrier *barrier, ticks_t now, uint32_t debounce);

#endif
