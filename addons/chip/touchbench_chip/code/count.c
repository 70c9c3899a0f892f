/* Instructions and stack of a frame and of a label on generated frames: SysTick at 25 MHz while QEMU counts a nanosecond for each. */

#include <stdint.h>
#include <stdio.h>

#include "touch.h"

#define CONTROL (*(volatile uint32_t *)0xE000E010)
#define RELOAD (*(volatile uint32_t *)0xE000E014)
#define VALUE (*(volatile uint32_t *)0xE000E018)
#define PER_TICK 40
#define UNUSED 0x5AFE57ACu /* what stack and heap hold until something is written there */
#define FORGET(here) for (volatile uint32_t *at = end; at < (here); at++) *at = UNUSED

extern uint32_t end[]; /* of data, where the heap begins, which nothing takes before printf */

#if TOUCH_WATCH
static touch_watch_t watch;
static touch_event_t event;
#define state watch.now
#else
static touch_t state;
#endif
static float frame[TOUCH_TAXELS], proba[TOUCH_CLASSES];
static uint32_t seed = 1;

/* Bytes below a place of the stack that were written to. */
static unsigned long used(volatile uint32_t *here)
{
    volatile uint32_t *at = end;
    while (at < here && *at == UNUSED)
        at++;
    return (unsigned long)(here - at) * sizeof *at;
}

static uint32_t since(uint32_t begin) { return ((begin - VALUE) & 0xFFFFFF) * PER_TICK; }

/* Frame n: noise of a strength that changes. */
static void generate(int n)
{
    for (int i = 0; i < TOUCH_TAXELS; i++) {
        seed = seed * 1103515245u + 12345u;
        frame[i] = TOUCH_FULL_SCALE * (float)(seed >> 16 & 255) / 1024 * (float)(1 + n / 7 % 3);
    }
}

int main(void)
{
    uint32_t most = 0, most_idle = 0, label_most = 0, both_most = 0;
    double all = 0;
    int count = (int)(8 * TOUCH_RATE_HZ), taken = 0, deciding = 0;
    volatile uint32_t *here;
    __asm volatile("mov %0, sp" : "=r"(here));
    FORGET(here);
    RELOAD = 0xFFFFFF;
    VALUE = 0;
    CONTROL = 5;
    touch_init(&state);
    for (int n = 0; n < count; n++) {
        generate(n);
        uint32_t begin = VALUE;
        int ready = touch_push(&state, frame);
        uint32_t spent = since(begin);
        if (ready < 0)
            break;
        all += spent;
        taken++;
        if (ready == 0 && spent > most_idle)
            most_idle = spent;
        if (spent > most)
            most = spent;
        if (ready || n % 8 == 0) {
            uint32_t both = spent;
            begin = VALUE;
            touch_label(&state, proba, 0);
            spent = since(begin);
            both += spent;
            if (spent > label_most)
                label_most = spent;
            if (both > both_most)
                both_most = both;
            deciding++;
        }
    }
    unsigned long stack = used(here);
#if TOUCH_WATCH
    FORGET(here);
    uint32_t watch_most = 0, watch_idle = 0;
    double watch_all = 0, idle_all = 0;
    touch_watch_init(&watch);
    for (int n = 0; n < 2 * count; n++) {
        generate(n);
        int touched = n >= count; /* as if nothing were touched, then as if a touch never ended */
        touch_watch_t *w = &watch;
        (void)touched, (void)w;
        /* PRETENDED */
        uint32_t begin = VALUE;
        touch_watch(&watch, frame, &event);
        uint32_t spent = since(begin);
        *(n < count ? &idle_all : &watch_all) += spent;
        if (n < count && spent > watch_idle)
            watch_idle = spent;
        if (n >= count && spent > watch_most)
            watch_most = spent;
    }
    unsigned long watch_stack = used(here);
    uint32_t recorded_most = 0, reports = 0;
    double recorded_all = 0, recorded = 0;
    FILE *frames = fopen("recorded.bin", "rb"); /* of a recording, in single precision, if there is one */
    touch_watch_init(&watch);
    while (frames && fread(frame, sizeof frame, 1, frames) == 1) {
        uint32_t begin = VALUE;
        reports += touch_watch(&watch, frame, &event) == TOUCH_REPORTED;
        uint32_t spent = since(begin);
        recorded_all += spent;
        recorded++;
        if (spent > recorded_most)
            recorded_most = spent;
    }
#endif
    if (most > both_most)
        both_most = most;
    printf("instructions: %lu a frame on average, at most %lu without and %lu with a window that ends; label at most %lu; "
           "a frame and its label at most %lu\n",
           (unsigned long)(all / taken + 0.5), (unsigned long)most_idle, (unsigned long)most, (unsigned long)label_most,
           (unsigned long)both_most);
#if TOUCH_WATCH
    printf("watching: %lu instructions a frame on average without touch and %lu with, at most %lu and %lu\n",
           (unsigned long)(idle_all / count + 0.5), (unsigned long)(watch_all / count + 0.5), (unsigned long)watch_idle,
           (unsigned long)watch_most);
    printf("watching: stack of %lu bytes at most, below the caller\n", watch_stack);
    if (recorded > 0)
        printf("watching a recording: %lu instructions a frame on average, at most %lu; %lu reports in %lu frames\n",
               (unsigned long)(recorded_all / recorded + 0.5), (unsigned long)recorded_most, (unsigned long)reports,
               (unsigned long)recorded);
#endif
    printf("stack: %lu bytes at most, below the caller\n", stack);
    return deciding ? 0 : 1;
}
