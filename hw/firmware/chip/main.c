/* The main loop: edges, bytes, rules, events; then sleep until the next interrupt, 64 us at most. */
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

/* Bytes handled before the rules have their turn again. */
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
    /* The level as it is now stands for all that were lost. */
    controller.edges_lost += lost;
    controller_edge(&controller, &(struct edge){timebase_now(), encoder_position(), barrier_level()});
}

static void reply_to_message(void)
{
    static struct reply reply;
    answer(&controller, &receiver, timebase_now(), &reply);
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

/* Events wait for room, and leave some to a reply. */
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
        if (guard_ticks() != guard_seen) { /* only if main loop and guard both live */
            guard_seen = guard_ticks();
            wdt_reset();
        }
        if (!serial_waits()) sleep_mode();
    }
}
