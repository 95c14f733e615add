#include "commands.h"

#include <stddef.h>
#include <string.h>

#include "hardware.h"
#include "version.h"

static void put(struct reply *reply, const void *payload, uint8_t size)
{
    memcpy(reply->payload, payload, size);
    reply->size = size;
}

static void refuse(struct reply *reply, uint8_t request, struct refusal why)
{
    struct nak_reply nak = {request, why.reason, why.field, 0, why.limit};
    reply->type = MSG_NAK;
    put(reply, &nak, sizeof nak);
}

static void reply_ident(const struct controller *c, struct reply *reply)
{
    struct ident ident = {
        .major = PROTOCOL_MAJOR, .minor = PROTOCOL_MINOR,
        .firmware = {FIRMWARE_MAJOR, FIRMWARE_MINOR, FIRMWARE_PATCH},
        .channels = LED_CHANNELS, .program_steps = PROGRAM_STEPS,
        .reset_cause = c->reset_cause, .boots = c->boots, .unit = c->unit,
        .build = FIRMWARE_BUILD, .board = "m328p16",
        .tick_ns = 1000 / TICKS_PER_US, .led_shortest = LED_SHORTEST, .led_longest = LED_LONGEST,
        .led_bucket = LED_BUCKET, .led_duty_shift = LED_DUTY_SHIFT, .heartbeat_s = HEARTBEAT / MS(1000),
        .ready_longest_ms = READY_LONGEST_MS, .trigger_longest = STEP_TRIGGER_LONGEST,
    };
    put(reply, &ident, sizeof ident);
}

static void reply_status(const struct controller *c, uint16_t bad, ticks_t now, struct reply *reply)
{
    struct status status = {
        .state = c->state, .fault = c->fault, .reset_cause = c->reset_cause, .blocked = c->barrier.raw,
        .run = c->run, .row = c->passage.row, .tick = now, .boots = c->boots,
        .config_crc = c->configuration.crc,
        .events_next = c->events.next, .events_first = events_first(&c->events),
        .position = (uint32_t)encoder_position(),
        .events_lost = c->events.lost, .bad_frames = bad, .unknown = c->unknown, .replies_lost = c->replies_lost,
        .bytes_lost = c->bytes_lost, .edges_lost = c->edges_lost,
        .ready = c->interlock.high, .hold = c->interlock.hold, .permit = c->interlock.permit,
        .contacts = c->contacts.levels, .taken = c->contacts.taken,
    };
    put(reply, &status, sizeof status);
}

static struct refusal set_step(struct controller *c, const struct step_request *request)
{
    if (request->index >= PROGRAM_STEPS) return (struct refusal){NAK_RANGE, request->index, PROGRAM_STEPS - 1};
    c->configuration.staged.steps[request->index] = request->step;
    return (struct refusal){NAK_NONE, 0, 0};
}

static struct refusal set_width(struct controller *c, const struct width_request *request)
{
    if (request->index >= PROGRAM_STEPS) return (struct refusal){NAK_RANGE, request->index, PROGRAM_STEPS - 1};
    c->configuration.staged.widths[request->index] = request->width;
    return (struct refusal){NAK_NONE, 0, 0};
}

static struct refusal commit(struct controller *c, uint32_t crc)
{
    if (c->state == STATE_ARMED || c->state == STATE_RUNNING) return (struct refusal){NAK_STATE, 0, c->state};
    return config_commit(&c->configuration, crc);
}

static struct refusal arm(struct controller *c, const struct arm_request *request, ticks_t now)
{
    /* A repeated ARM whose reply was lost must succeed, although the controller is armed now. */
    uint8_t armed = c->state == STATE_ARMED || c->state == STATE_RUNNING;
    if (armed && c->run == request->run && c->configuration.crc == request->config_crc)
        return (struct refusal){NAK_NONE, 0, 0};
    if (c->state != STATE_IDLE || c->pulse.under_way) return (struct refusal){NAK_STATE, 0, c->state};
    if (!c->configuration.crc) return (struct refusal){NAK_UNCONFIGURED, 0, 0};
    if (c->configuration.crc != request->config_crc)
        return (struct refusal){NAK_CHECKSUM, 0, c->configuration.crc};
    controller_arm(c, request->run, now);
    return (struct refusal){NAK_NONE, 0, 0};
}

static struct refusal read_event(const struct controller *c, uint32_t number, struct reply *reply)
{
    const struct event *event = event_read(&c->events, number);
    if (!event) return (struct refusal){NAK_GONE, 0, events_first(&c->events)};
    put(reply, event, sizeof *event);
    return (struct refusal){NAK_NONE, 0, 0};
}

static int8_t payload_size(uint8_t type)
{
    switch (type) {
    case MSG_IDENT: case MSG_STATUS: case MSG_BEAT: case MSG_DISARM: case MSG_SAFE: return 0;
    case MSG_CLOCK: case MSG_COMMIT: case MSG_READ_EVENT: case MSG_ACK_EVENTS: return 4;
    case MSG_TIMING: return sizeof(struct timing);
    case MSG_STEP: return sizeof(struct step_request);
    case MSG_WIDTH: return sizeof(struct width_request);
    case MSG_ARM: return sizeof(struct arm_request);
    case MSG_FIRE_ONE: return sizeof(struct fire_request);
    case MSG_READY: return sizeof(struct ready_request);
    case MSG_OFFER: return sizeof(struct offer_request);
    default: return -1;
    }
}

void handle_request(struct controller *c, const struct receiver *message, ticks_t now, struct reply *reply)
{
    const uint8_t type = message_type(message);
    const int8_t size = payload_size(type);
    union { /* a copy, because payloads in the receive buffer need not be aligned */
        uint32_t number;
        struct timing timing;
        struct step_request step;
        struct width_request width;
        struct arm_request arm;
        struct fire_request fire;
        struct ready_request ready;
        struct offer_request offer;
    } request;
    struct refusal why = {NAK_NONE, 0, 0};

    reply->type = type | MSG_REPLY;
    reply->size = 0;
    if (size < 0) {
        c->unknown++;
        why.reason = NAK_UNKNOWN;
    } else if (message->payload_size != size) {
        why = (struct refusal){NAK_LENGTH, 0, (uint32_t)size};
    }
    if (why.reason) {
        refuse(reply, type, why);
        return;
    }
    memcpy(&request, message_payload(message), (size_t)size);
    switch (type) {
    case MSG_IDENT: reply_ident(c, reply); break;
    case MSG_BEAT: c->last_beat = now; /* fall through */
    case MSG_STATUS: reply_status(c, message->bad, now, reply); break;
    case MSG_CLOCK: put(reply, &(struct clock_reply){request.number, now}, sizeof(struct clock_reply)); break;
    case MSG_TIMING: config_set_timing(&c->configuration.staged, &request.timing); break;
    case MSG_STEP: why = set_step(c, &request.step); break;
    case MSG_WIDTH: why = set_width(c, &request.width); break;
    case MSG_COMMIT:
        why = commit(c, request.number);
        put(reply, &c->configuration.crc, 4);
        break;
    case MSG_ARM: why = arm(c, &request.arm, now); break;
    case MSG_DISARM: controller_disarm(c, now); break;
    case MSG_FIRE_ONE: why = controller_fire(c, &request.fire, now); break;
    case MSG_SAFE: controller_safe(c, FAULT_COMMANDED, now); break;
    case MSG_READ_EVENT: why = read_event(c, request.number, reply); break;
    case MSG_ACK_EVENTS: events_acknowledge(&c->events, request.number); break;
    case MSG_READY:
        why = interlock_state(c, &request.ready, now);
        reply_status(c, message->bad, now, reply);
        break;
    case MSG_OFFER:
        why = contacts_offer(c, &request.offer, now);
        reply_status(c, message->bad, now, reply);
        break;
    }
    interlock_poll(c, now); /* DISARM and SAFE lower the output at once, SAFE opens the contacts */
    contacts_poll(c, now);
    if (why.reason) refuse(reply, type, why);
}
