/* The functions that tests/hw calls through ctypes: one controller on a simulated chip. */
#include "bridge.h"

#include <string.h>

static struct controller controller;
static struct receiver receiver;

/* What may be known about the output "line ready" without its rules. */
static struct { uint8_t blocked, stated, offered; ticks_t stated_at, offered_at; } outside;

/* Returns the first violation of the chip's limits or of the output's promises in words, or NULL. */
const char *bridge_violation(ticks_t now)
{
    if (chip_offered() && (!outside.offered || now - outside.offered_at > MS((uint32_t)READY_LONGEST_MS)))
        return "a board is offered without a host";
    if (chip_offered() && controller.state == STATE_SAFE) return "a board is offered in the safe state";
    if (chip_violation() || !chip_ready()) return chip_violation();
    if (!outside.stated || now - outside.stated_at > MS((uint32_t)READY_LONGEST_MS)) return "line ready without a host";
    if (controller.interlock.permit == PERMIT_TEST) return controller.state == STATE_IDLE ? NULL : "a test while armed";
    if (outside.blocked) return "line ready while the barrier is blocked";
    return controller.state == STATE_ARMED ? NULL : "line ready while not armed";
}

void bridge_start(ticks_t now) { bridge_boot(now, 1); }

void bridge_boot(ticks_t now, uint32_t boots)
{
    chip_reset(now);
    memset(&receiver, 0, sizeof receiver);
    memset(&outside, 0, sizeof outside);
    controller_start(&controller, now, 0, boots, 1);
}

void bridge_edge(ticks_t tick, uint8_t blocked)
{
    outside.blocked = blocked;
    controller_edge(&controller, &(struct edge){tick, encoder_position(), blocked});
}

void bridge_encoder(int32_t position) { chip_set_encoder(position); }

void bridge_poll(ticks_t now)
{
    chip_advance(now);
    controller_poll(&controller, now);
}

/* Feeds bytes, writes the reply frames and returns their size. */
uint32_t bridge_talk(const uint8_t *bytes, uint32_t count, uint8_t *frames, ticks_t now)
{
    uint32_t size = 0;
    struct reply reply;
    while (count--)
        if (receive(&receiver, *bytes++)) {
            handle_request(&controller, &receiver, now, &reply);
            if (reply.type == (MSG_READY | MSG_REPLY)) {
                outside.stated = 1;
                outside.stated_at = now;
            }
            if (reply.type == (MSG_OFFER | MSG_REPLY)) {
                outside.offered = 1;
                outside.offered_at = now;
            }
            size += make_frame(frames + size, reply.type, message_sequence(&receiver), reply.payload, reply.size);
        }
    return size;
}

uint16_t bridge_bad_frames(void) { return receiver.bad; }

/* Takes the next event to send; returns 0 if there is none. */
uint8_t bridge_event(struct event *event)
{
    const struct event *next = event_to_send(&controller.events);
    if (!next) return 0;
    *event = *next;
    event_was_sent(&controller.events);
    return 1;
}
