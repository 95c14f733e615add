#include "events.h"

#include <stddef.h>

static_assert((EVENTS_KEPT & (EVENTS_KEPT - 1)) == 0, "numbers are masked");

void event_add(struct events *e, ticks_t tick, uint8_t kind, uint8_t detail, uint16_t index, uint32_t value)
{
    if (e->next - e->acknowledged >= EVENTS_KEPT) {
        e->acknowledged++; /* the oldest event is overwritten, and the host may not have it */
        e->lost++;
    }
    e->kept[e->next & (EVENTS_KEPT - 1)] = (struct event){e->next, tick, kind, detail, index, value};
    e->next++;
}

uint32_t events_first(const struct events *e) { return e->next < EVENTS_KEPT ? 0 : e->next - EVENTS_KEPT; }

const struct event *event_read(const struct events *e, uint32_t number)
{
    if (number < events_first(e) || number >= e->next) return NULL;
    return &e->kept[number & (EVENTS_KEPT - 1)];
}

void events_acknowledge(struct events *e, uint32_t next_wanted)
{
    if (next_wanted > e->acknowledged && next_wanted <= e->next) e->acknowledged = next_wanted;
}

const struct event *event_to_send(struct events *e)
{
    /* While the serial line was busy, events may have been overwritten before they were sent. */
    if (e->sent < events_first(e)) e->sent = events_first(e);
    return event_read(e, e->sent);
}

void event_was_sent(struct events *e) { e->sent++; }
