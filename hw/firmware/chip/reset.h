/* Reset cause, boot counter, unit number and watchdog. */
#ifndef RESET_H
#define RESET_H

#include <stdint.h>

uint8_t reset_cause(void);
uint32_t reset_count(void); /* increments the counter: call it once */
uint32_t unit_number(void);
void watchdog_start(void);

#endif
