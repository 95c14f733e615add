/* The light barrier on the input capture pin, and the quadrature encoder. */
#ifndef INPUTS_H
#define INPUTS_H

#include "barrier.h"

void inputs_start(void);
uint8_t barrier_level(void);
/* Takes the oldest edge; returns 0 if there is none. */
uint8_t take_edge(struct edge *edge);
/* Returns and resets the count of edges that found the buffer full. */
uint8_t take_edges_lost(void);

#endif
