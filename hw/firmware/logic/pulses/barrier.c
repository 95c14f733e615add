#include "barrier.h"

uint32_t barrier_edge(struct barrier *b, const struct edge *edge)
{
    if (edge->blocked == b->raw) return 0;
    b->raw = edge->blocked;
    if (b->pending) {
        b->pending = 0;
        uint32_t lasted = edge->tick - b->edge.tick;
        return lasted ? lasted : 1; /* 0 means "no bounce", and both edges may have the same tick */
    }
    b->pending = 1;
    b->edge = *edge;
    return 0;
}

uint8_t barrier_poll(struct barrier *b, ticks_t now, uint32_t debounce)
{
    if (!b->pending || ticks_since(now, b->edge.tick) < (int32_t)debounce) return 0;
    b->pending = 0;
    b->confirmed = b->raw;
    return 1;
}
