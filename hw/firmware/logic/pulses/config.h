/* The configuration: staged piece by piece, then checked as a whole and activated at once. */
#ifndef CONFIG_H
#define CONFIG_H

#include "budget.h"

struct config {
    struct timing timing;
    struct step steps[PROGRAM_STEPS];
    uint16_t widths[PROGRAM_STEPS]; /* of the trigger, by step */
};

struct configuration {
    struct config staged, active;
    uint32_t crc; /* of the active configuration; 0: none */
};

struct refusal { uint8_t reason, field; uint32_t limit; };

/* Sets the timing, and the trigger's width of every step to that of the timing. */
void config_set_timing(struct config *config, const struct timing *timing);
/* The trigger's width of a step if it is not that of the timing, else 0. */
uint16_t config_own_width(const struct config *config, uint8_t step);
/* CRC-32 of the timing and the steps that it uses, and of their widths if one differs from that of the timing. */
uint32_t config_crc(const struct config *config);
/* Returns NAK_NONE or the refusal; fields are numbered as in struct timing, 16 + k is step k, 32 + k its trigger's width. */
struct refusal config_check(const struct config *config);
struct refusal config_commit(struct configuration *configuration, uint32_t crc);

#endif
