/* Limits that no command can change. The LED limits belong to the LEDs on the drivers: edit, build and flash. */
#ifndef LIMITS_H
#define LIMITS_H

#include "ticks.h"

#define LED_CHANNELS 4
/* Longest pulse of each channel in ticks; a longer one destroys over-driven LEDs. */
#define LED_LONGEST { US(1000), US(1000), US(500), US(500) }
/* A pulse shorter than the latency of an interrupt could not be ended by the compare unit. With serial
 * line, encoder and barrier all at work that was 42 us at most on the emulated chip. */
#define LED_SHORTEST US(50)
/* Each channel is lit 1/16 of the time at most ... */
#define LED_DUTY_SHIFT 4
/* ... averaged by a bucket that holds this much light. It is empty after a reset, so that repeated resets
 * give no extra light. */
#define LED_BUCKET US(4000)

#define PROGRAM_STEPS 16
#define TRIGGER_SHORTEST US(50)
#define TRIGGER_LONGEST US(2000)
/* Of a step with a width of its own, for which cameras may expose. Less than half the range of 16-bit compare times. */
#define STEP_TRIGGER_LONGEST US(10000)
/* The trigger has fallen this long before the next row is due: PREPARE, and the time of the main loop to get round. */
#define TRIGGER_CLEARANCE MS(3)

#define PERIOD_SHORTEST MS(5)
/* Half the range in which two times can be compared. */
#define TIME_LONGEST (1UL << 30)

/* A row is given to the compare unit this long before it is due, which is the time of the main loop to get round. */
#define PREPARE MS(2)
/* A row nearer than this is suppressed: the compare unit might miss it. */
#define TOO_LATE US(100)
/* Delay and tail exceed the debounce by this: an edge must be confirmed before PREPARE of the row it decides on. */
#define DECISION MS(4)
/* Paced by distance, a row is due this long after the encoder reached its place. */
#define ENCODER_LATENCY MS(1)

/* Longer than any stall of the host that must be survived. */
#define HEARTBEAT MS(3000)

/* Longest time for which one statement of the host keeps the output "line ready" high: the time after which a conveyor
 * holds boards back when the host is gone. */
#define READY_LONGEST_MS 1000

/* Shortest time for which that output stays low, and contacts to the next machine stay open, by which a neighbour tells two boards apart (IPC-SMEMA-9851). */
#define READY_PAUSE MS(50)

/* A contact of a neighbour counts when its level has lasted for this: relays bounce for less, and boards take longer. */
#define CONTACT_DEBOUNCE MS(10)

#endif
