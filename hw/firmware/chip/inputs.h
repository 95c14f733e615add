/* The light barrier on the input capture pin, and the quadrature encoder. */
#ifndef INPUTS_H
#define INPUTS_H

#include "barrier.h"

void inputs_start(void);
uint8_t barrier_level(void);
/* The oldest edge not yet taken; 0 if there is none. */
uint8_t take_edge(struct edge *edge);
/* Edges that came too fast to be kept, since last asked. */
uint8_t take_edges_lost(void);

#endif
