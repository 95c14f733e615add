/* The messages of hw/protocol.md, version 1.4: little-endian, packed; sizes are part of the protocol. */
#ifndef PROTOCOL_H
#define PROTOCOL_H

#include <assert.h>
#include <stdint.h>

#include "limits.h"

#define PROTOCOL_MAJOR 1
#define PROTOCOL_MINOR 4

#define PAYLOAD_LONGEST 58
#define CONTENT_LONGEST (2 + PAYLOAD_LONGEST + 2) /* type, sequence, payload, CRC-16 */
#define FRAME_LONGEST (CONTENT_LONGEST + 2)       /* COBS adds one byte, the delimiter another */

enum message {
    MSG_IDENT = 0x01,
    MSG_STATUS = 0x02,
    MSG_CLOCK = 0x03,
    MSG_BEAT = 0x04,
    MSG_TIMING = 0x05,
    MSG_STEP = 0x06,
    MSG_COMMIT = 0x07,
    MSG_ARM = 0x08,
    MSG_DISARM = 0x09,
    MSG_FIRE_ONE = 0x0A,
    MSG_SAFE = 0x0B,
    MSG_READ_EVENT = 0x0C,
    MSG_ACK_EVENTS = 0x0D,
    MSG_READY = 0x0E,
    MSG_WIDTH = 0x0F,
    MSG_OFFER = 0x10,
    MSG_REPLY = 0x80, /* added to the type of the request */
    MSG_EVENT = 0xC0,
    MSG_NAK = 0xFF,
};

enum nak {
    NAK_NONE = 0,
    NAK_UNKNOWN = 1,      /* no such request in this version */
    NAK_LENGTH = 2,       /* payload of another size; limit: the right one */
    NAK_RANGE = 3,        /* a field outside its range; field: which, limit: the nearest allowed value */
    NAK_LED_LIMIT = 4,    /* longer or more frequent than the LEDs allow; field: channel, limit in ticks */
    NAK_STATE = 5,        /* not in this state; limit: the state */
    NAK_CHECKSUM = 6,     /* not the checksum of this configuration; limit: the right one */
    NAK_LED_BUDGET = 7,   /* the LEDs have not cooled down yet; field: channel */
    NAK_GONE = 8,         /* the event was overwritten or has not occurred; limit: oldest kept */
    NAK_UNCONFIGURED = 9, /* no configuration was committed since the reset */
};

enum state { STATE_IDLE = 0, STATE_ARMED = 1, STATE_RUNNING = 2, STATE_SAFE = 3 };

enum fault { FAULT_NONE = 0, FAULT_HEARTBEAT = 1, FAULT_COMMANDED = 2, FAULT_GUARD = 3 };

enum pacing { PACING_TIME = 0, PACING_DISTANCE = 1 };

enum event_kind {
    EVENT_BOOT = 1,       /* detail: reset cause (MCUSR), value: boot counter */
    EVENT_BARRIER = 2,    /* detail: 1 blocked, 0 clear; index: run */
    EVENT_PULSE = 3,      /* detail: LED channels, index: row, value: on-time in ticks; see PULSE_VALUE */
    EVENT_SUPPRESSED = 4, /* detail: enum suppressed, index: row, value: see there */
    EVENT_RUN_END = 5,    /* detail: enum run_end, index: pulses fired, value: rows suppressed */
    EVENT_FAULT = 6,      /* detail: enum fault */
    EVENT_EDGE = 7,       /* detail: 1 blocked again within a run, 0 clear outside a run; index: run */
    EVENT_CONTACTS = 8,   /* detail: enum contact; index: board taken last, value: board offered last */
};

enum suppressed {
    SUPPRESSED_BOUNCE = 1,     /* the barrier changed for less than the debounce; value: ticks */
    SUPPRESSED_GAP = 2,        /* a board within the minimum gap after the last; value: ticks since that left */
    SUPPRESSED_LATE = 3,       /* the row could not be prepared in time */
    SUPPRESSED_LED_BUDGET = 4, /* the LEDs have not cooled down; value: channel */
    SUPPRESSED_TOO_FAST = 5,   /* the encoder demands rows faster than min_period; value: ticks since the last */
};

enum run_end { END_CLEAR = 1, END_MAX_ROWS = 2, END_DISARMED = 3, END_SAFE = 4 };

/* Why the output "line ready" is low. */
enum hold {
    HOLD_NONE = 0,    /* it is high */
    HOLD_HOST = 1,    /* the host has not stated that a board may come, or its statement has run out */
    HOLD_STATE = 2,   /* not armed, or a board is being filmed */
    HOLD_BARRIER = 3, /* the barrier is blocked, or was until less than the debounce ago */
    HOLD_GAP = 4,     /* the last board left less than min_gap ago */
    HOLD_SPENT = 5,   /* a board has come since the host's statement */
};

/* Since 1.4: the contacts of the neighbours by IPC-SMEMA-9851; 1: closed. */
enum contact {
    CONTACT_AVAILABLE = 1 << 0,      /* in, of the machine upstream: a board waits */
    CONTACT_FAILED = 1 << 1,         /* in, of the machine upstream: a failed board waits */
    CONTACT_NEXT_READY = 1 << 2,     /* in, of the next machine: it takes a board */
    CONTACT_OFFERED = 1 << 4,        /* out, to the next machine: a board waits */
    CONTACT_OFFERED_FAILED = 1 << 5, /* out, to the next machine: a failed board waits */
};

#define PERMIT_TEST 0 /* of MSG_READY: sets the output without a board, in STATE_IDLE only */

/* Value of EVENT_PULSE: below, the on-time of the LEDs; above, since 1.3, the trigger's width if MSG_WIDTH has set it. */
#define PULSE_VALUE(on, own_width) ((uint32_t)(own_width) << 16 | (on))

#define ROW_NONE 0xFFFFu /* the pulse of FIRE_ONE belongs to no row */

#define WIRE __attribute__((packed))

struct WIRE timing {
    uint8_t pacing;
    uint8_t steps;          /* of the program, 1 to 16 */
    uint16_t max_rows;
    uint32_t start_delay;   /* barrier edge to row 0: ticks, or encoder counts */
    uint32_t period;        /* row to row: ticks, or encoder counts */
    uint32_t tail;          /* rows continue after the board has left: ticks, or encoder counts */
    uint32_t min_period;    /* ticks; shortest period of cameras and LEDs */
    uint32_t debounce;      /* ticks */
    uint32_t min_gap;       /* ticks the barrier must be clear between two boards */
    uint16_t trigger_width; /* ticks */
};
static_assert(sizeof(struct timing) == 30, "part of the protocol");

struct WIRE step {
    uint8_t channels; /* bit k: LED channel k; none: cameras without light */
    uint8_t reserved;
    uint16_t width;   /* ticks; 0 exactly if there is no channel */
};
static_assert(sizeof(struct step) == 4, "part of the protocol");

struct WIRE step_request { uint8_t index; struct step step; };
static_assert(sizeof(struct step_request) == 5, "part of the protocol");

/* Since 1.3: the trigger's width of one step, which cameras may expose for. TIMING sets that of all steps. */
struct WIRE width_request { uint8_t index, reserved; uint16_t width; };
static_assert(sizeof(struct width_request) == 4, "part of the protocol");

struct WIRE ident {
    uint8_t major, minor;
    uint8_t firmware[3];
    uint8_t channels;
    uint8_t program_steps;
    uint8_t reset_cause;
    uint32_t boots;
    uint32_t unit;          /* from EEPROM; 0xFFFFFFFF: never set */
    char build[8];          /* start of the commit's id, zeros if unknown */
    char board[8];
    uint16_t tick_ns;
    uint16_t led_shortest;
    uint16_t led_longest[LED_CHANNELS];
    uint16_t led_bucket;
    uint8_t led_duty_shift; /* lit at most 1 / 2^shift of the time */
    uint8_t heartbeat_s;
    uint16_t ready_longest_ms; /* since 1.2: how long one READY keeps the output high at most */
    uint16_t trigger_longest;  /* since 1.3: ticks, the longest width of MSG_WIDTH and FIRE_ONE */
};
static_assert(sizeof(struct ident) == 52, "part of the protocol");

struct WIRE status {
    uint8_t state;
    uint8_t fault;          /* cause of STATE_SAFE */
    uint8_t reset_cause;
    uint8_t blocked;        /* present level of the barrier */
    uint16_t run;
    uint16_t row;           /* next row of the run under way */
    uint32_t tick;
    uint32_t boots;
    uint32_t config_crc;    /* 0: nothing committed since the reset */
    uint32_t events_next;   /* number of the next event */
    uint32_t events_first;  /* oldest that can be read again */
    uint32_t position;      /* encoder counts */
    uint16_t events_lost;   /* overwritten before they were acknowledged */
    uint16_t bad_frames;
    uint16_t unknown;
    uint16_t replies_lost;  /* no room in the transmit buffer */
    uint16_t bytes_lost;    /* arrived faster than they were read */
    uint16_t edges_lost;    /* the barrier changed faster than edges were read */
    uint8_t ready;          /* since 1.2: level of the output "line ready" */
    uint8_t hold;           /* enum hold */
    uint16_t permit;        /* of the last READY */
    uint8_t contacts;       /* since 1.4: enum contact */
    uint8_t reserved;
    uint16_t taken;         /* number of the board that the next machine has taken last; 0: none since the reset */
};
static_assert(sizeof(struct status) == 52, "part of the protocol");

struct WIRE event {
    uint32_t number;
    uint32_t tick;
    uint8_t kind;
    uint8_t detail;
    uint16_t index;
    uint32_t value;
};
static_assert(sizeof(struct event) == 16, "part of the protocol");

struct WIRE clock_reply { uint32_t nonce, tick; };
static_assert(sizeof(struct clock_reply) == 8, "part of the protocol");

struct WIRE arm_request { uint16_t run; uint32_t config_crc; };
static_assert(sizeof(struct arm_request) == 6, "part of the protocol");

struct WIRE fire_request { uint16_t nonce; struct step step; uint16_t trigger_width; };
static_assert(sizeof(struct fire_request) == 8, "part of the protocol");

struct WIRE ready_request {
    uint16_t permit;  /* number of the host's permission for one board; PERMIT_TEST */
    uint16_t hold_ms; /* how long it is valid; 0 withdraws it */
};
static_assert(sizeof(struct ready_request) == 4, "part of the protocol");

/* Since 1.4: what the contacts to the next machine say of the board behind the cameras. */
struct WIRE offer_request {
    uint16_t board;    /* its number, another one for each board, from 1; one that was taken is not offered again. 0: none */
    uint16_t hold_ms;  /* how long this is valid; 0: no board is offered */
    uint8_t contacts;  /* CONTACT_OFFERED, CONTACT_OFFERED_FAILED or both: those that close */
    uint8_t reserved;
    uint16_t least_ms; /* a next machine that is not ready any more sooner than this has only withdrawn */
    uint16_t most_ms;  /* the board is taken at the latest when the next machine has been ready for it for this long */
};
static_assert(sizeof(struct offer_request) == 10, "part of the protocol");

struct WIRE nak_reply { uint8_t request, reason, field, reserved; uint32_t limit; };
static_assert(sizeof(struct nak_reply) == 8, "part of the protocol");

#endif
