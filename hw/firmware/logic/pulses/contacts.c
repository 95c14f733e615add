#include "contacts.h"

#include "controller.h"
#include "hardware.h"

#define OUTPUTS (CONTACT_OFFERED | CONTACT_OFFERED_FAILED)

static void debounce_inputs(struct contacts *k, ticks_t now)
{
    const uint8_t differ = contacts_read() ^ k->levels;
    for (uint8_t n = 0; n < CONTACT_INPUTS; n++) {
        if (!(differ >> n & 1)) k->agreed[n] = now;
        else if (now - k->agreed[n] >= CONTACT_DEBOUNCE) k->levels ^= (uint8_t)(1 << n);
    }
}

/* The next machine has a board when it is not ready any more; sooner than `least` it has only withdrawn. */
static void watch_transfer(struct contacts *k, ticks_t now)
{
    const uint8_t ready = k->levels & CONTACT_NEXT_READY;
    if (k->moving) {
        uint32_t took = now - k->met;
        if (took >= MS((uint32_t)k->offer.most_ms) || (!ready && took >= MS((uint32_t)k->offer.least_ms))) k->taken = k->offer.board;
        if (!ready || k->taken == k->offer.board) k->moving = 0;
    } else if (ready && k->levels & OUTPUTS) {
        k->moving = 1;
        k->met = now;
    }
}

static void open_outputs(struct contacts *k, ticks_t now)
{
    if (k->levels & OUTPUTS) {
        k->opened = now;
        k->paused = 1;
    }
    k->levels &= (uint8_t)~OUTPUTS;
}

struct refusal contacts_offer(struct controller *c, const struct offer_request *request, ticks_t now)
{
    struct contacts *k = &c->contacts;
    if (request->hold_ms > READY_LONGEST_MS) return (struct refusal){NAK_RANGE, 0, READY_LONGEST_MS};
    if (request->contacts & (uint8_t)~OUTPUTS) return (struct refusal){NAK_RANGE, 1, OUTPUTS};
    if (request->least_ms > request->most_ms) return (struct refusal){NAK_RANGE, 2, request->most_ms};
    if (!k->used || !request->board) { /* a host that begins gets the present levels */
        k->used = 1;
        k->reported = (uint8_t)~k->levels;
    }
    if (request->hold_ms) {
        /* Each board, and each change of what is said of it, shows by an opening. */
        if (request->board != k->offer.board) k->moving = 0;
        if (request->board != k->offer.board || request->contacts != k->offer.contacts) open_outputs(k, now);
        k->offer = *request;
    }
    k->since = now;
    k->lasting = MS((uint32_t)request->hold_ms);
    contacts_poll(c, now);
    return (struct refusal){NAK_NONE, 0, 0};
}

void contacts_poll(struct controller *c, ticks_t now)
{
    struct contacts *k = &c->contacts;
    debounce_inputs(k, now);
    watch_transfer(k, now);
    if (now - k->since >= k->lasting) k->lasting = 0;
    if (now - k->opened >= READY_PAUSE) k->paused = 0;
    if (!k->lasting || k->taken == k->offer.board || c->state == STATE_SAFE) open_outputs(k, now);
    else if (!k->paused) k->levels = (k->levels & (uint8_t)~OUTPUTS) | k->offer.contacts;
    contacts_output(k->levels);
    if (k->used && k->levels != k->reported) {
        k->reported = k->levels;
        event_add(&c->events, now, EVENT_CONTACTS, k->levels, k->taken, k->offer.board);
    }
}
