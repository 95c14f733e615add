/* The firmware on an emulated ATmega328P, with its pins and its serial port on stdin and stdout. See README.md.
 *
 *          emulator FIRMWARE.elf                simulated time: the same commands give the same output
 *          emulator FIRMWARE.elf --pty LINK     real time, with the serial port as the terminal LINK
 */
#include "emulator.h"

#include <avr_ioport.h>
#include <avr_uart.h>
#include <sim_avr.h>
#include <sim_elf.h>
#include <sim_regbit.h>

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define BYTE_CYCLES 704 /* 11 bits at 250 000 baud, which simavr uses per byte */
#define TRAP 0x7F00     /* flash far behind the firmware: an instruction that jumps to itself */
#define ADDRESS_TCCR1A 0x80

struct output { const char *name; uint8_t com_shift; uint8_t level; };
static struct output outputs[] = {{"PB1", 6, 0}, {"PB2", 4, 0}, {"PD4", 0, 0}, {"PD5", 0, 0}, {"PD6", 0, 0}, {"PD7", 0, 0}, {"PC0", 0, 0}, {"PC1", 0, 0}, {"PC2", 0, 0}};
static uint8_t inputs[26][8]; /* levels by port letter and bit, to be applied again after a reset */

avr_t *avr;
static uint8_t *to_send;
static size_t to_send_count, to_send_next;
static char sent[4096];
static size_t sent_count;
static avr_cycle_count_t sent_at;
static long encoder_left;
static avr_cycle_count_t encoder_every;
static uint8_t encoder_phase;
static double noise_in, noise_out;
static uint32_t random_state = 1;

static avr_irq_t *pin(const char *name) { return avr_io_getirq(avr, AVR_IOCTL_IOPORT_GETIRQ(name[1]), name[2] - '0'); }

static void flush_sent(void)
{
    if (sent_count) printf("sent %llu %.*s\n", (unsigned long long)sent_at, (int)sent_count, sent);
    sent_count = 0;
}

/* simavr up to 1.7 treats compare outputs as in PWM modes: an overflow between a match and the interrupt that disconnects
 * the pin raises a pin in "clear" mode and lowers one in "set" mode. No chip does that, so such an edge is not
 * reported, and the level is restored one cycle later. */
static int is_artefact(const struct output *output, uint32_t level)
{
    if (!output->com_shift) return 0;
    uint8_t mode = avr->data[ADDRESS_TCCR1A] >> output->com_shift & 3;
    return (level && mode == 2) || (!level && mode == 3);
}

static avr_cycle_count_t restore_level(avr_t *unused, avr_cycle_count_t when, void *param)
{
    const struct output *output = param;
    (void)unused, (void)when;
    avr_raise_irq(pin(output->name), output->level);
    return 0;
}

static void on_output(avr_irq_t *irq, uint32_t value, void *param)
{
    struct output *output = param;
    uint8_t level = value & 1;
    (void)irq;
    if (level == output->level) return;
    if (is_artefact(output, level)) {
        avr_cycle_timer_register(avr, 1, restore_level, output);
        return;
    }
    output->level = level;
    printf("edge %llu %s %u\n", (unsigned long long)avr->cycle, output->name, level);
}

static double random_share(void)
{
    random_state = random_state * 1664525u + 1013904223u;
    return (double)(random_state >> 8) / (1 << 24);
}

/* Flips one bit of a byte with this probability. */
static uint8_t add_noise(uint8_t byte, double noise)
{
    return noise > 0 && random_share() < noise ? byte ^ (1 << (int)(8 * random_share())) : byte;
}

static void buffer_byte(uint8_t byte)
{
    if (sent_count + 3 > sizeof sent) flush_sent();
    if (!sent_count) sent_at = avr->cycle;
    sent_count += (size_t)sprintf(sent + sent_count, "%02x", byte);
}

static void on_byte(avr_irq_t *irq, uint32_t value, void *param)
{
    uint8_t byte = add_noise((uint8_t)value, noise_out);
    (void)irq, (void)param;
    if (terminal_is_used()) terminal_put(byte);
    else buffer_byte(byte);
}

static avr_cycle_count_t feed(avr_t *unused, avr_cycle_count_t when, void *param)
{
    (void)unused, (void)param;
    if (to_send_next == to_send_count) return 0;
    uint8_t byte = add_noise(to_send[to_send_next++], noise_in);
    avr_raise_irq(avr_io_getirq(avr, AVR_IOCTL_UART_GETIRQ('0'), UART_IRQ_INPUT), byte);
    return when + BYTE_CYCLES;
}

void send_to_chip(const uint8_t *bytes, size_t count)
{
    uint8_t *all = malloc(to_send_count - to_send_next + count + 1);
    if (!all) exit(2);
    memcpy(all, to_send + to_send_next, to_send_count - to_send_next);
    to_send_count -= to_send_next;
    memcpy(all + to_send_count, bytes, count);
    to_send_count += count;
    free(to_send);
    to_send = all;
    to_send_next = 0;
    if (!avr_cycle_timer_status(avr, feed, NULL)) avr_cycle_timer_register(avr, BYTE_CYCLES, feed, NULL);
}

static size_t from_hex(const char *hex, uint8_t *bytes)
{
    size_t count = strlen(hex) / 2;
    for (size_t k = 0; k < count; k++) {
        unsigned byte = 0;
        sscanf(hex + 2 * k, "%2x", &byte);
        bytes[k] = (uint8_t)byte;
    }
    return count;
}

static void set_input(const char *name, uint8_t level)
{
    inputs[name[1] - 'A'][name[2] - '0'] = level;
    avr_raise_irq(pin(name), level);
}

struct change { char name[4]; uint8_t level; };

static avr_cycle_count_t make_change(avr_t *unused, avr_cycle_count_t when, void *param)
{
    struct change *change = param;
    (void)unused, (void)when;
    set_input(change->name, change->level);
    return 0;
}

static void schedule(avr_cycle_count_t when, const char *name, unsigned level)
{
    struct change *change = malloc(sizeof *change);
    if (!change) exit(2);
    memcpy(change->name, name, sizeof change->name);
    change->level = (uint8_t)level;
    avr_cycle_timer_register(avr, when > avr->cycle ? when - avr->cycle : 1, make_change, change);
}

static avr_cycle_count_t turn_encoder(avr_t *unused, avr_cycle_count_t when, void *param)
{
    static const uint8_t A[4] = {0, 1, 1, 0}, B[4] = {0, 0, 1, 1};
    (void)unused, (void)param;
    if (!encoder_left) return 0;
    encoder_phase = (encoder_phase + (encoder_left > 0 ? 1 : 3)) % 4;
    encoder_left -= encoder_left > 0 ? 1 : -1;
    if (inputs['D' - 'A'][2] != A[encoder_phase]) set_input("PD2", A[encoder_phase]);
    if (inputs['D' - 'A'][3] != B[encoder_phase]) set_input("PD3", B[encoder_phase]);
    return when + encoder_every;
}

/* The encoder's way of a passage: the cycles of all its counts, forwards. */
static avr_cycle_count_t travel[1 << 16];
static size_t travel_count, travel_next;

static avr_cycle_count_t step_travel(avr_t *unused, avr_cycle_count_t when, void *param)
{
    if (travel_next == travel_count) return 0;
    travel_next++;
    encoder_left = 1;
    turn_encoder(unused, when, param);
    if (travel_next == travel_count) return 0;
    return travel[travel_next] > when ? travel[travel_next] : when + 1;
}

/* Takes the cycle of the first count, and for each further one the cycles since the one before it. */
static void plan_travel(const char *numbers)
{
    char *end;
    avr_cycle_count_t at = 0;
    travel_count = travel_next = 0;
    while (travel_count < sizeof travel / sizeof *travel) {
        unsigned long long more = strtoull(numbers, &end, 10);
        if (end == numbers) break;
        numbers = end;
        travel[travel_count++] = at += more;
    }
    avr_cycle_timer_cancel(avr, step_travel, NULL);
    if (travel_count) avr_cycle_timer_register(avr, travel[0] > avr->cycle ? travel[0] - avr->cycle : 1, step_travel, NULL);
}

/* The registers were cleared, but the inputs keep their levels: they belong to the world outside. */
static void after_reset(void)
{
    flush_sent();
    printf("reset %llu\n", (unsigned long long)avr->cycle);
    to_send_next = to_send_count;
    for (int port = 0; port < 26; port++)
        for (int bit = 0; bit < 8; bit++)
            if (inputs[port][bit]) set_input((char[]){'P', (char)('A' + port), (char)('0' + bit), 0}, 1);
}

static void reset(const char *cause, unsigned bootloader_ms)
{
    avr_reset(avr);
    avr_regbit_set(avr, !strcmp(cause, "power") ? avr->reset_flags.porf : avr->reset_flags.extrf);
    after_reset();
    if (terminal_is_used()) terminal_hold(bootloader_ms);
}

int run(avr_cycle_count_t cycles)
{
    avr_cycle_count_t end = avr->cycle + cycles;
    while (avr->cycle < end) {
        avr_run_t before = avr->run;
        int state = avr_run(avr);
        if (state == cpu_Done || state == cpu_Crashed) return 0;
        if (avr->run != before && avr->pc == avr->reset_pc) after_reset(); /* simavr exchanges avr->run for a watchdog reset */
    }
    return 1;
}

static void hang(int deaf)
{
    avr->flash[TRAP] = 0xFF, avr->flash[TRAP + 1] = 0xCF; /* rjmp .-2 */
    avr->pc = TRAP;
    avr->state = cpu_Running;
    if (deaf) avr->sreg[S_I] = 0;
}

static int execute(const char *line)
{
    unsigned long long a = 0, b = 0;
    char name[4], cause[9];
    static char hex[1 << 20];
    static uint8_t bytes[1 << 19];
    if (!terminal_is_used() && sscanf(line, "run %llu", &a) == 1) return run(a);
    if (sscanf(line, "send %1048575s", hex) == 1) send_to_chip(bytes, from_hex(hex, bytes));
    else if (terminal_execute(line)) return 1;
    else if (sscanf(line, "noise %lf %lf %u", &noise_in, &noise_out, &random_state) >= 2) return 1;
    else if (sscanf(line, "board %llu", &a) == 1) {
        schedule(avr->cycle + a, "PB0", 0);
        set_input("PB0", 1);
    } else if (sscanf(line, "pin %3s %llu", name, &a) == 2) set_input(name, a != 0);
    else if (sscanf(line, "at %llu %3s %llu", &a, name, &b) == 3) schedule(a, name, b != 0);
    else if (!strncmp(line, "travel ", 7)) plan_travel(line + 7);
    else if (sscanf(line, "encoder %ld %llu", &encoder_left, &a) == 2) {
        encoder_every = a;
        avr_cycle_timer_register(avr, a, turn_encoder, NULL);
    } else if (sscanf(line, "poke %llx %llx", &a, &b) == 2) avr->data[a] = (uint8_t)b;
    else if (sscanf(line, "reset %8[a-z] %llu", cause, &a) >= 1) reset(cause, (unsigned)a);
    else if (!strncmp(line, "hang", 4)) hang(0);
    else if (!strncmp(line, "deaf", 4)) hang(1);
    else {
        fprintf(stderr, "unknown command: %s", line);
        exit(2);
    }
    return 1;
}

/* simavr really sleeps while the chip sleeps; the pace is set here or in terminal.c. */
static void no_real_sleep(avr_t *unused, avr_cycle_count_t how_long) { (void)unused, (void)how_long; }

static void start(const char *path)
{
    elf_firmware_t firmware = {0};
    uint32_t flags = 0;
    if (elf_read_firmware(path, &firmware)) {
        fprintf(stderr, "cannot read %s\n", path);
        exit(2);
    }
    avr = avr_make_mcu_by_name("atmega328p");
    if (!avr) exit(2);
    avr_init(avr);
    avr->log = LOG_NONE;
    firmware.frequency = HZ;
    avr_load_firmware(avr, &firmware);
    avr->sleep = no_real_sleep;
    avr_ioctl(avr, AVR_IOCTL_UART_GET_FLAGS('0'), &flags);
    /* STDIO would echo on the console; POLL_SLEEP would sleep whenever the firmware polls the UART. */
    flags &= (uint32_t)~(AVR_UART_FLAG_STDIO | AVR_UART_FLAG_POLL_SLEEP);
    avr_ioctl(avr, AVR_IOCTL_UART_SET_FLAGS('0'), &flags);
    for (int bit = 3; bit < 6; bit++) set_input((char[]){'P', 'C', (char)('0' + bit), 0}, 1); /* open contacts are pulled up */
    for (size_t k = 0; k < sizeof outputs / sizeof *outputs; k++)
        avr_irq_register_notify(pin(outputs[k].name), on_output, &outputs[k]);
    avr_irq_register_notify(avr_io_getirq(avr, AVR_IOCTL_UART_GETIRQ('0'), UART_IRQ_OUTPUT), on_byte, NULL);
}

static void execute_line(const char *line)
{
    int alive = execute(line);
    flush_sent();
    printf("%s %llu\n", alive ? "ok" : "crashed", (unsigned long long)avr->cycle);
    fflush(stdout);
}

int main(int argc, char **argv)
{
    static char line[COMMAND_LONGEST];
    if (argc == 4 && !strcmp(argv[2], "--pty")) {
        start(argv[1]);
        return terminal_serve(argv[3], execute_line);
    }
    if (argc != 2) {
        fprintf(stderr, "usage: emulator FIRMWARE.elf [--pty LINK]\n");
        return 2;
    }
    start(argv[1]);
    while (fgets(line, sizeof line, stdin)) execute_line(line);
    return 0;
}
