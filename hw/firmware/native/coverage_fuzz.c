/* A coverage-guided fuzzer: inputs that reach new edges of the control flow are kept and mutated further.
 *
 *          coverage_fuzz INPUTS [SEED]
 *
 * The compiler reports the branches of the logic (-fsanitize-coverage=trace-pc); this file is built without it. An input
 * is a script for one controller, see play(). Checksums are corrected on the way, else every frame would be rejected.
 */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "bridge.h"

#define KEPT 1024
#define LONGEST 400
#define EDGES (1 << 14)

void __sanitizer_cov_trace_pc(void);

struct input { uint16_t size; uint8_t bytes[LONGEST]; };

static struct input corpus[KEPT];
static uint32_t kept, edges;
static uint8_t known[EDGES];
static uint8_t found_new;
static uintptr_t last_place;
static uint64_t state;
static uint8_t answers[1 << 12];
static ticks_t now;

void __sanitizer_cov_trace_pc(void)
{
    uintptr_t place = (uintptr_t)__builtin_return_address(0);
    uintptr_t edge = (place ^ last_place * 31) % EDGES;
    last_place = place;
    if (known[edge]) return;
    known[edge] = 1;
    found_new = 1;
    edges++;
}

static uint32_t random_below(uint32_t below)
{
    state ^= state >> 12;
    state ^= state << 25;
    state ^= state >> 27;
    return (uint32_t)((state * 2685821657736338717ULL) >> 33) % below;
}

static uint32_t send(uint8_t type, const void *payload, uint8_t size)
{
    uint8_t frame[FRAME_LONGEST];
    return bridge_talk(frame, make_frame(frame, type, 1, payload, size), answers, now);
}

/* The refusal of a wrong checksum has the right one as its limit, which the second round sends. */
static void commit_and_arm(void)
{
    struct receiver reply = {0};
    struct arm_request arm = {1, 0};
    for (uint8_t round = 0; round < 2; round++) {
        uint32_t size = send(MSG_COMMIT, &arm.config_crc, 4);
        for (uint32_t k = 0; k < size; k++)
            if (receive(&reply, answers[k]))
                memcpy(&arm.config_crc, message_payload(&reply) + (message_type(&reply) == MSG_NAK ? 4 : 0), 4);
    }
    send(MSG_ARM, &arm, sizeof arm);
}

static void wait(uint32_t polls, ticks_t step)
{
    while (polls--) bridge_poll(now += step);
}

/* An order is one byte and its data: a message (type, payload), raw bytes, time, an edge, an encoder position, commit. */
static void play(const struct input *input)
{
    const uint8_t *at = input->bytes, *end = at + input->size;
    static uint8_t blocked;
    static int32_t position;
    blocked = 0;
    position = 0;
    last_place = 0;
    bridge_start(now);
    while (end - at >= 3) {
        uint8_t order = *at++, size = order >> 2;
        if (size > end - at) size = (uint8_t)(end - at);
        switch (order & 3) {
        case 0:
            if (size) send(at[0], at + 1, size > PAYLOAD_LONGEST ? PAYLOAD_LONGEST : size - 1);
            break;
        case 1: bridge_talk(at, size, answers, now); break;
        case 2:
            wait(at[0], at[1] & 1 ? MS(13) : US(500));
            size = 2;
            break;
        case 3:
            if (order & 4) commit_and_arm();
            else if (order & 8) bridge_edge(now, blocked ^= 1);
            else bridge_encoder(position += (int8_t)at[0]);
            size = 1;
            break;
        }
        at += size;
        bridge_poll(now += US(64));
    }
}

static void change(struct input *input)
{
    const struct input *other = &corpus[random_below(kept)];
    for (uint32_t k = 1 + random_below(4); k > 0; k--) {
        uint32_t at = random_below(input->size + 1u), room = LONGEST - input->size;
        switch (random_below(5)) {
        case 0: if (input->size) input->bytes[random_below(input->size)] ^= (uint8_t)(1 << random_below(8)); break;
        case 1: if (input->size) input->bytes[random_below(input->size)] = (uint8_t)random_below(256); break;
        case 2: input->size = (uint16_t)at; break;
        case 3:
            for (uint32_t n = random_below(20); n > 0 && input->size < LONGEST; n--) input->bytes[input->size++] = (uint8_t)random_below(256);
            break;
        case 4: {
            uint32_t from = random_below(other->size + 1u), count = other->size - from;
            if (count > room) count = room;
            memmove(input->bytes + input->size, other->bytes + from, count);
            input->size = (uint16_t)(input->size + count);
        }
        }
    }
}

/* The first input: one valid run and one pulse. The fuzzer finds the rest. */
static void seed_corpus(void)
{
    const struct timing timing = {PACING_TIME, 1, 20, MS(10), MS(16), MS(10), MS(16), MS(1), MS(5), US(100)};
    const struct step_request step = {0, {1, 0, (uint16_t)US(300)}};
    const struct fire_request fire = {1, {1, 0, (uint16_t)US(1000)}, US(100)};
    uint8_t *at = corpus[0].bytes;
    *at++ = (sizeof timing + 1) << 2;
    *at++ = MSG_TIMING;
    at = (uint8_t *)memcpy(at, &timing, sizeof timing) + sizeof timing;
    *at++ = (sizeof step + 1) << 2;
    *at++ = MSG_STEP;
    at = (uint8_t *)memcpy(at, &step, sizeof step) + sizeof step;
    *at++ = (sizeof fire + 1) << 2;
    *at++ = MSG_FIRE_ONE;
    at = (uint8_t *)memcpy(at, &fire, sizeof fire) + sizeof fire;
    memcpy(at, (const uint8_t[]){2, 20, 0, 7, 0, 11, 0, 2, 200, 0, 11, 0, 2, 200, 0}, 15);
    corpus[0].size = (uint16_t)(at + 15 - corpus[0].bytes);
    kept = 1;
    play(&corpus[0]);
}

static const char *fault_after_play(void)
{
    if (bridge_violation(now)) return bridge_violation(now);
    bridge_talk((const uint8_t[]){0}, 1, answers, now); /* ends a frame that noise left open */
    return send(MSG_STATUS, NULL, 0) ? NULL : "no answer to STATUS";
}

int main(int argc, char **argv)
{
    uint32_t inputs = argc > 1 ? (uint32_t)strtoul(argv[1], NULL, 10) : 100000, first, pulses;
    state = 0x9E3779B97F4A7C15ULL ^ (argc > 2 ? strtoul(argv[2], NULL, 10) : 1);
    seed_corpus();
    first = edges;
    pulses = chip_pulses();
    for (uint32_t k = 0; k < inputs; k++) {
        struct input input = corpus[random_below(kept)];
        change(&input);
        found_new = 0;
        play(&input);
        pulses += chip_pulses();
        const char *fault = fault_after_play();
        if (fault) {
            fprintf(stderr, "input %u: %s\n", k, fault);
            for (uint16_t n = 0; n < input.size; n++) fprintf(stderr, "%02x", input.bytes[n]);
            return 1;
        }
        if (found_new && kept < KEPT) corpus[kept++] = input;
    }
    printf("%u inputs, %u kept, edges %u -> %u, %u pulses: no LED beyond its limits, every STATUS answered\n", inputs, kept,
           first, edges, pulses);
    return 3 * edges < 4 * first; /* without new edges the guidance does not work */
}
