#include "framing.h"

#include <string.h>

#include "checksum.h"

/* Decodes in place, which is safe because reading never falls behind writing. Returns the size, 0 if it is no COBS. */
static uint8_t cobs_decode(uint8_t *bytes, uint8_t count)
{
    uint8_t from = 0, to = 0;
    while (from < count) {
        uint8_t code = bytes[from++];
        if (code - 1 > count - from) return 0;
        for (uint8_t k = 1; k < code; k++) bytes[to++] = bytes[from++];
        /* A code of 0xFF would stand for no zero, but frames are too short for it. */
        if (from < count) bytes[to++] = 0;
    }
    return to;
}

static uint8_t complete(struct receiver *r)
{
    uint8_t size = cobs_decode(r->bytes, r->count);
    if (size < 4) return 0;
    uint16_t sent = (uint16_t)(r->bytes[size - 2] | r->bytes[size - 1] << 8);
    r->payload_size = size - 4;
    return crc16(r->bytes, size - 2) == sent;
}

uint8_t receive(struct receiver *r, uint8_t byte)
{
    if (byte) {
        if (r->count < sizeof r->bytes) r->bytes[r->count++] = byte;
        else r->overlong = 1;
        return 0;
    }
    /* Two delimiters in a row are no error: senders may begin with one to end earlier noise. */
    uint8_t empty = !r->count, good = !empty && !r->overlong && complete(r);
    if (!empty && !good) r->bad++;
    r->count = r->overlong = 0;
    return good;
}

uint8_t make_frame(uint8_t *frame, uint8_t type, uint8_t sequence, const void *payload, uint8_t size)
{
    uint8_t content[CONTENT_LONGEST];
    content[0] = type;
    content[1] = sequence;
    if (size) memcpy(content + 2, payload, size);
    uint16_t crc = crc16(content, size + 2);
    content[size + 2] = (uint8_t)crc;
    content[size + 3] = (uint8_t)(crc >> 8);

    uint8_t code_at = 0, to = 1;
    for (uint8_t k = 0; k < size + 4; k++) {
        if (content[k]) {
            frame[to++] = content[k];
        } else {
            frame[code_at] = to - code_at;
            code_at = to++;
        }
    }
    frame[code_at] = to - code_at;
    frame[to++] = 0;
    return to;
}
