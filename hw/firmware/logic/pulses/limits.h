/* What no command can change. The LED limits are those of the LEDs on the drivers: edit, build and flash. */
#ifndef LIMITS_H
#define LIMITS_H

#include "ticks.h"

#define LED_CHANNELS 4
/* Longest pulse of each channel in ticks; over-driven LEDs die of a longer one. */
#define LED_LONGEST { US(1000), US(1000), US(500), US(500) }
/* A pulse shorter than the latency of an interrupt could not be ended by the compare unit. With serial
 * line, encoder and barrier all at work that was 42 us at most on the emulated chip. */
#define LED_SHORTEST US(50)
/* Each channel is lit 1/16 of the time at most ... */
#define LED_DUTY_SHIFT 4
/* ... averaged by a bucket that holds this much light. It is empty after a reset, so that resets give no light away. */
#define LED_BUCKET US(4000)

#define PROGRAM_STEPS 16
#define TRIGGER_SHORTEST US(50)
#define TRIGGER_LONGEST US(2000)

#define PERIOD_SHORTEST MS(5)
/* Half the range in which two times can be compared. */
#define TIME_LONGEST (1UL << 30)

/* A row is handed to the compare unit this long before it is due: the main loop has all of it to get round. */
#define PREPARE MS(2)
/* Nearer than this the compare unit might miss it. */
#define TOO_LATE US(100)
/* Delay and tail must be longer than the debounce by this: an edge has to be sure before it decides on a row. */
#define DECISION MS(4)
/* Paced by distance, a row is due this long after the encoder reached its place. */
#define ENCODER_LATENCY MS(1)

#define HEARTBEAT MS(3000)

#endif
