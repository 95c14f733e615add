/* Events, numbered from 0 since the reset. The last ones can be read again, so that loss on the line is
 * repaired. */
#ifndef EVENTS_H
#define EVENTS_H

#include "protocol.h"

#define EVENTS_KEPT 32 /* a power of two */

struct events {
    struct event kept[EVENTS_KEPT];
    uint32_t next;         /* number of the next one */
    uint32_t acknowledged; /* the host has received all events before this one */
    uint32_t sent;         /* number of the next one to send */
    uint16_t lost;         /* overwritten before they were acknowledged */
};

void event_add(struct events *events, ticks_t tick, uint8_t kind, uint8_t detail, uint16_t index, uint32_t value);
uint32_t events_first(const struct events *events);
const struct event *event_read(const struct events *events, uint32_t number); /* or NULL */
void events_acknowledge(struct events *events, uint32_t next_wanted);
const struct event *event_to_send(struct events *events); /* or NULL; then call event_was_sent */
void event_was_sent(struct events *events);

#endif
