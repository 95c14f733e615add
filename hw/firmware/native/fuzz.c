/* Random frames, valid, damaged and meaningless, for the whole logic: parser, commands, rules. Run with sanitizers.
 *
 *          fuzz FRAMES [SEED]
 *
 * Fails if an LED is lit beyond limits.h, if the output "line ready" is high without reason, or if the controller stops replying.
 */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "bridge.h"

static uint64_t state;

static uint32_t random_below(uint32_t below) /* xorshift64*, the same sequence on every machine */
{
    state ^= state >> 12;
    state ^= state << 25;
    state ^= state >> 27;
    return (uint32_t)((state * 2685821657736338717ULL) >> 33) % below;
}

static const struct timing GOOD = {PACING_TIME, 4, 500, MS(10), MS(17), MS(10), MS(16), MS(1), MS(5), US(100)};

/* Mostly payloads of valid size and often valid content: meaningless ones never pass the first check. */
static uint8_t make_payload(uint8_t type, uint8_t *payload)
{
    uint8_t size = random_below(PAYLOAD_LONGEST + 1);
    for (uint8_t k = 0; k < size; k++) payload[k] = (uint8_t)random_below(256);
    if (random_below(8) == 0) return size;
    switch (type) {
    case MSG_TIMING: {
        struct timing timing = GOOD;
        timing.pacing = random_below(4) == 0;
        timing.period = random_below(4) ? MS(5) + random_below(MS(60)) : random_below(1000);
        timing.min_period = MS(5) + random_below(MS(20));
        memcpy(payload, &timing, sizeof timing);
        if (random_below(4) == 0) payload[random_below(sizeof timing)] ^= (uint8_t)(1 << random_below(8));
        return sizeof timing;
    }
    case MSG_STEP: {
        uint16_t width = (uint16_t)(random_below(6) ? 40 + random_below(900) : random_below(2600));
        struct step_request step = {(uint8_t)random_below(5), {(uint8_t)(1 + random_below(15)), 0, width}};
        memcpy(payload, &step, sizeof step);
        return sizeof step;
    }
    case MSG_FIRE_ONE: {
        struct step light = {(uint8_t)(1 + random_below(16)), 0, (uint16_t)random_below(2200)};
        struct fire_request fire = {(uint16_t)random_below(65536), light, (uint16_t)random_below(5000)};
        memcpy(payload, &fire, sizeof fire);
        return sizeof fire;
    }
    case MSG_READY: {
        struct ready_request ready = {(uint16_t)random_below(4), (uint16_t)random_below(1100)};
        memcpy(payload, &ready, sizeof ready);
        return sizeof ready;
    }
    case MSG_OFFER: {
        uint16_t least_ms = (uint16_t)random_below(20);
        struct offer_request offer = {(uint16_t)random_below(4), (uint16_t)random_below(1100), (uint8_t)(random_below(4) << 4), 0,
                                      least_ms, (uint16_t)(least_ms + random_below(100))};
        memcpy(payload, &offer, sizeof offer);
        return sizeof offer;
    }
    case MSG_CLOCK: case MSG_READ_EVENT: case MSG_ACK_EVENTS: return 4;
    default: return 0;
    }
}

static uint8_t answers[1 << 16];
static ticks_t now;
static uint32_t ready_polls;

static uint32_t send(uint8_t type, const void *payload, uint8_t size, uint8_t damage)
{
    uint8_t frame[FRAME_LONGEST + 8];
    uint8_t count = make_frame(frame, type, (uint8_t)random_below(256), payload, size);
    if (damage) frame[random_below(count)] = (uint8_t)random_below(256);
    return bridge_talk(frame, count, answers, now);
}

static void commit_and_arm(void)
{
    struct receiver reply = {0};
    uint32_t crc = 0;
    /* The refusal of a wrong checksum has the right one as its limit. */
    for (uint8_t round = 0; round < 2; round++) {
        uint32_t size = send(MSG_COMMIT, &crc, 4, 0);
        for (uint32_t k = 0; k < size; k++)
            if (receive(&reply, answers[k])) {
                const uint8_t *payload = message_payload(&reply);
                memcpy(&crc, message_type(&reply) == MSG_NAK ? payload + 4 : payload, 4);
            }
    }
    struct arm_request arm = {(uint16_t)random_below(65536), crc};
    send(MSG_ARM, &arm, sizeof arm, 0);
}

/* The longest pulses at the highest rate, so that only the duty limit stops them. */
static void fire_as_fast_as_possible(void)
{
    for (uint8_t k = 0; k < 12; k++) {
        struct fire_request fire = {(uint16_t)random_below(65536), {(uint8_t)(1 + random_below(3)), 0, US(1000)}, US(100)};
        send(MSG_FIRE_ONE, &fire, sizeof fire, 0);
        for (uint8_t poll = 0; poll < 8; poll++) bridge_poll(now += US(500));
    }
}

static void send_random(void)
{
    uint8_t payload[PAYLOAD_LONGEST], noise[80];
    uint8_t type = random_below(10) ? 1 + random_below(16) : (uint8_t)random_below(256);
    if ((type == MSG_SAFE || type == MSG_DISARM) && random_below(5)) type = MSG_CLOCK; /* else hardly any run would last */
    switch (random_below(12)) {
    case 0:
        for (uint8_t k = 0; k < sizeof noise; k++) noise[k] = (uint8_t)random_below(256);
        bridge_talk(noise, 1 + random_below(sizeof noise), answers, now);
        break;
    case 1: commit_and_arm(); break;
    case 2: send(MSG_BEAT, NULL, 0, 0); break;
    case 3:
        if (random_below(20) == 0) fire_as_fast_as_possible();
        break;
    default: send(type, payload, make_payload(type, payload), random_below(10) == 0);
    }
}

static void pass_time(void)
{
    static uint8_t blocked;
    static int32_t position;
    for (uint32_t k = random_below(30); k > 0; k--) {
        now += random_below(12) ? US(64) : random_below(random_below(50) ? MS(6) : MS(3500));
        if (random_below(20) == 0) bridge_edge(now, blocked ^= 1);
        if (random_below(40) == 0) chip_close((uint8_t)random_below(8));
        if (random_below(3) == 0) bridge_encoder(position += (int32_t)random_below(40) - 4);
        bridge_poll(now);
        ready_polls += chip_ready();
        if (bridge_violation(now)) return;
    }
}

static void check(uint32_t frame)
{
    const char *violation = bridge_violation(now);
    struct event event;
    while (bridge_event(&event)) {}
    if (!violation) {
        bridge_talk((const uint8_t[]){0}, 1, answers, now); /* ends a frame that damage left open */
        if (!send(MSG_STATUS, NULL, 0, 0)) violation = "no answer to STATUS";
    }
    if (!violation) return;
    fprintf(stderr, "frame %u: %s\n", frame, violation);
    exit(1);
}

int main(int argc, char **argv)
{
    uint32_t frames = argc > 1 ? (uint32_t)strtoul(argv[1], NULL, 10) : 300000, pulses = 0;
    uint32_t seed = argc > 2 ? (uint32_t)strtoul(argv[2], NULL, 10) : 1;
    state = 0x9E3779B97F4A7C15ULL ^ seed;
    bridge_start(now);
    for (uint32_t k = 0; k < frames; k++) {
        send_random();
        pass_time();
        check(k);
        pulses += chip_pulses();
    }
    printf("%u frames, %u pulses, %u bad frames, %u polls with line ready: no LED beyond its limits, line ready only when "
           "permitted, every STATUS answered\n", frames, pulses, bridge_bad_frames(), ready_polls);
    return pulses < frames / 100 || ready_polls < frames / 100; /* without them the limits were not tested */
}
