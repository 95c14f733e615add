/* The main loop: edges, rules, bytes, events; then sleep until the next interrupt, at most 64 us. */
#include <avr/interrupt.h>
#include <avr/sleep.h>
#include <avr/wdt.h>

#include "board.h"
#include "commands.h"
#include "hardware.h"
#include "inputs.h"
#include "outputs.h"
#include "reset.h"
#include "serial.h"
#include "timebase.h"

/* Bytes handled per turn: a full serial line must not delay the rules. */
#define BYTES_AT_ONCE 16

static struct controller controller;
static struct receiver receiver;
static uint8_t frame[FRAME_LONGEST];

static void take_edges(void)
{
    struct edge edge;
    while (take_edge(&edge)) controller_edge(&controller, &edge);
    uint8_t lost = take_edges_lost();
    if (!lost) return;
    /* One edge with the present level replaces all lost ones: what matters is whether the barrier is blocked. */
    controller.edges_lost += lost;
    controller_edge(&controller, &(struct edge){timebase_now(), encoder_position(), barrier_level()});
}

static void reply_to_message(void)
{
    static struct reply reply;
    handle_request(&controller, &receiver, timebase_now(), &reply);
    uint8_t size = make_frame(frame, reply.type, message_sequence(&receiver), reply.payload, reply.size);
    if (serial_room() >= size) serial_send(frame, size);
    else controller.replies_lost++;
}

static void take_bytes(void)
{
    int16_t byte;
    for (uint8_t k = 0; k < BYTES_AT_ONCE && (byte = serial_take()) >= 0; k++)
        if (receive(&receiver, (uint8_t)byte)) {
            reply_to_message();
            break;
        }
    controller.bytes_lost += serial_take_lost();
}

/* An event is sent only if a reply still finds room afterwards: replies are not stored, events are. */
static void send_event(void)
{
    if (serial_room() < 2 * FRAME_LONGEST) return;
    const struct event *event = event_to_send(&controller.events);
    if (!event) return;
    serial_send(frame, make_frame(frame, MSG_EVENT, (uint8_t)controller.boots, event, sizeof *event));
    event_was_sent(&controller.events);
}

int main(void)
{
    uint8_t guard_seen = 0;
    outputs_start();
    uint32_t boots = reset_count();
    timebase_start();
    inputs_start();
    serial_start();
    controller_start(&controller, 0, barrier_level(), boots, reset_cause());
    controller.unit = unit_number();
    set_sleep_mode(SLEEP_MODE_IDLE);
    watchdog_start();
    sei();
    for (;;) {
        take_edges();
        controller_poll(&controller, timebase_now());
        take_bytes();
        send_event();
        if (guard_ticks() != guard_seen) { /* only while main loop and guard both run */
            guard_seen = guard_ticks();
            wdt_reset();
        }
        if (!serial_waits()) sleep_mode();
    }
}
