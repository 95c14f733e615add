/* The configuration: staged piece by piece, then checked as a whole and activated at once. */
#ifndef CONFIG_H
#define CONFIG_H

#include "budget.h"

struct config { struct timing timing; struct step steps[PROGRAM_STEPS]; };

struct configuration {
    struct config staged, active;
    uint32_t crc; /* of the active configuration; 0: none */
};

struct refusal { uint8_t reason, field; uint32_t limit; };

/* CRC-32 of the timing and the steps that it uses. */
uint32_t config_crc(const struct config *config);
/* Returns NAK_NONE or the refusal; fields are numbered as in struct timing, 16 + k is step k. */
struct refusal config_check(const struct config *config);
struct refusal config_commit(struct configuration *configuration, uint32_t crc);

#endif
