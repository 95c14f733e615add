/* Conversion between bytes and messages: COBS(type, sequence, payload, CRC-16), 0x00. */
#ifndef FRAMING_H
#define FRAMING_H

#include "protocol.h"

struct receiver {
    uint8_t bytes[CONTENT_LONGEST + 1]; /* as received; decoded in place to save memory */
    uint8_t count;
    uint8_t overlong;                   /* the frame is too long: skip it up to the next delimiter */
    uint8_t payload_size;               /* of the message just received */
    uint16_t bad;                       /* count of damaged frames */
};

/* Takes one byte; true if it completed a message, which the functions below then return. */
uint8_t receive(struct receiver *receiver, uint8_t byte);

static inline uint8_t message_type(const struct receiver *r) { return r->bytes[0]; }
static inline uint8_t message_sequence(const struct receiver *r) { return r->bytes[1]; }
static inline const uint8_t *message_payload(const struct receiver *r) { return r->bytes + 2; }

/* Writes the frame of a message, including the delimiter; returns its size. `frame` has room for FRAME_LONGEST. */
uint8_t make_frame(uint8_t *frame, uint8_t type, uint8_t sequence, const void *payload, uint8_t size);

#endif
