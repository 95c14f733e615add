/* The configuration: written piece by piece to one side, then checked as a whole and taken over at once. */
#ifndef CONFIG_H
#define CONFIG_H

#include "budget.h"

struct config { struct timing timing; struct step steps[PROGRAM_STEPS]; };

struct configuration {
    struct config staged, active;
    uint32_t crc; /* of the active one; 0: none */
};

struct refusal { uint8_t reason, field; uint32_t limit; };

/* Of the timing and as many steps as it uses. */
uint32_t config_crc(const struct config *config);
/* NAK_NONE, or what is wrong; fields are numbered as in struct timing, 16 + k is step k. */
struct refusal config_check(const struct config *config);
struct refusal config_commit(struct configuration *configuration, uint32_t crc);

#endif
