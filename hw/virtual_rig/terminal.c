/* The chip's serial port as a pseudo terminal, with the chip's time following CLOCK_MONOTONIC.
 *
 * The chip runs up to the present; then the process waits for half a millisecond, for bytes or for a command. After a
 * delay of the computer the chip catches up, so its time is right in the long run.
 */
#define _GNU_SOURCE
#include "emulator.h"

#include <errno.h>
#include <fcntl.h>
#include <poll.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <termios.h>
#include <time.h>
#include <unistd.h>

#define SLICE_NS 500000L
#define NS_PER_S 1000000000LL
/* Longest run without passing the chip's bytes on, while it catches up. */
#define AT_ONCE (HZ / 200)

static const char *link_path;
static int master = -1;
static long long cycle_0_ns; /* CLOCK_MONOTONIC of cycle 0, corrected for the times the chip was held */
static long long held_until_ns;
static uint8_t out[4096];
static size_t out_count;

static long long now_ns(void)
{
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return now.tv_sec * NS_PER_S + now.tv_nsec;
}

static long long cycles_ns(avr_cycle_count_t cycles) { return (long long)((double)cycles * (1e9 / HZ)); }

static void print_clock(void)
{
    printf("clock %llu %lld\n", (unsigned long long)avr->cycle, cycle_0_ns + cycles_ns(avr->cycle));
}

static void fail(const char *what)
{
    perror(what);
    exit(2);
}

/* The link is renamed into place, so that it is never seen half made. The terminal is raw before any program opens it, so
 * that it echoes nothing. */
static void plug(void)
{
    char draft[4096];
    struct termios raw;
    if (master >= 0) return;
    master = posix_openpt(O_RDWR | O_NOCTTY | O_NONBLOCK | O_CLOEXEC);
    if (master < 0 || grantpt(master) || unlockpt(master)) fail("pseudo terminal");
    int slave = open(ptsname(master), O_RDWR | O_NOCTTY);
    if (slave < 0 || tcgetattr(slave, &raw)) fail("pseudo terminal");
    cfmakeraw(&raw);
    tcsetattr(slave, TCSANOW, &raw);
    close(slave);
    snprintf(draft, sizeof draft, "%s.new", link_path);
    unlink(draft);
    if (symlink(ptsname(master), draft) || rename(draft, link_path)) fail(link_path);
}

static void unplug(void)
{
    if (master < 0) return;
    unlink(link_path);
    close(master);
    master = -1;
    out_count = 0;
}

int terminal_is_used(void) { return link_path != NULL; }

void terminal_put(uint8_t byte)
{
    if (out_count < sizeof out) out[out_count++] = byte;
}

/* Bytes that no program reads are lost, as on a wire. */
static void flush_out(void)
{
    if (master >= 0 && out_count) {
        struct pollfd there = {.fd = master, .events = POLLOUT};
        if (poll(&there, 1, 0) == 1 && !(there.revents & POLLHUP) && write(master, out, out_count) < 0 &&
            errno != EAGAIN && errno != EIO)
            fail("pseudo terminal");
    }
    out_count = 0;
}

/* Runs up to the present in steps, so that the chip's bytes are passed on in between. */
static int run_to_present(void)
{
    avr_cycle_count_t present = (avr_cycle_count_t)((now_ns() - cycle_0_ns) * (long long)(HZ / 1000000) / 1000);
    while (now_ns() >= held_until_ns && avr->cycle < present) {
        if (!run(present - avr->cycle < AT_ONCE ? present - avr->cycle : AT_ONCE)) return 0;
        flush_out();
    }
    return 1;
}

/* Bytes are read first and sent after the run: the chip must not receive them before the time of their arrival. */
static int run_and_feed(void)
{
    uint8_t bytes[4096];
    ssize_t count = master < 0 ? 0 : read(master, bytes, sizeof bytes);
    int held = now_ns() < held_until_ns, alive = run_to_present();
    if (count > 0 && !held) send_to_chip(bytes, (size_t)count);
    return alive;
}

void terminal_hold(unsigned ms)
{
    cycle_0_ns += ms * 1000000LL;
    held_until_ns = now_ns() + ms * 1000000LL;
    print_clock();
}

int terminal_execute(const char *line)
{
    if (!link_path) return 0;
    if (!strncmp(line, "unplug", 6)) unplug();
    else if (!strncmp(line, "plug", 4)) plug();
    else return 0;
    return 1;
}

/* Executes all complete lines; returns 0 at the end of stdin. */
static int read_commands(void (*execute_line)(const char *line))
{
    static char text[COMMAND_LONGEST];
    static size_t count;
    ssize_t more = read(STDIN_FILENO, text + count, sizeof text - 1 - count);
    if (more < 0 && errno == EAGAIN) return 1;
    if (more <= 0) return 0;
    count += (size_t)more;
    text[count] = 0;
    char *line = text, *end;
    while ((end = strchr(line, '\n'))) {
        *end = 0;
        execute_line(line);
        line = end + 1;
    }
    count = strlen(line);
    memmove(text, line, count);
    return 1;
}

static void wait_for_input(void)
{
    /* A terminal without a client always polls as ready (POLLHUP): leave it out, or this would spin. */
    struct pollfd events[2] = {{.fd = STDIN_FILENO, .events = POLLIN}, {.fd = master, .events = POLLIN}};
    poll(events, 2, 0);
    int closed = events[1].revents & POLLHUP;
    ppoll(events, closed ? 1 : 2, &(struct timespec){0, SLICE_NS}, NULL);
}

int terminal_serve(const char *link, void (*execute_line)(const char *line))
{
    int alive = 1;
    link_path = link;
    fcntl(STDIN_FILENO, F_SETFL, fcntl(STDIN_FILENO, F_GETFL) | O_NONBLOCK);
    plug();
    cycle_0_ns = now_ns();
    printf("ready %s\n", ptsname(master));
    print_clock();
    fflush(stdout);
    while (read_commands(execute_line)) {
        if (alive && !(alive = run_and_feed())) printf("crashed %llu\n", (unsigned long long)avr->cycle);
        flush_out();
        fflush(stdout);
        wait_for_input();
    }
    unplug();
    return 0;
}
