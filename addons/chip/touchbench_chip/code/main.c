/* Frames from standard input, a line each, a blank line ends a capture; a line per decision, as bench live.
   touch -w watches an endless stream, if there is a watcher: a line whenever an event is reported, renamed or over. */

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "touch.h"

#ifndef HOP_MS
#define HOP_MS 125.0
#endif

enum { FRAME, BLANK, REFUSED, ENDED };
enum { CHARACTERS = 32 }; /* most of a number; a line has at most as many for each taxel, its end included */

#if TOUCH_WATCH
static touch_watch_t watch; /* has the room of a capture as well */
#define state watch.now
#else
static touch_t state;
#endif
static float frame[TOUCH_TAXELS];

/* The next byte of the input; CR LF is LF, and CR at the end of the input is the end. */
static int next_byte(int *bytes)
{
    int c = getchar();
    if (c == EOF)
        return c;
    ++*bytes;
    if (c != '\r')
        return c;
    int after = getchar();
    if (after == '\n')
        ++*bytes;
    return after == '\n' || after == EOF ? after : '\r';
}

/* Read a line: decimal numbers, with a comma between them and blanks (spaces, tabs) around it, or with blanks alone. */
static int read_line(void)
{
    char word[CHARACTERS + 1];
    int bytes = 0, length = 0, count = 0;
    char between = 0, gap = 0; /* first two numbers, and behind the last one: a blank, a comma or nothing */
    for (;;) {
        int c = next_byte(&bytes);
        if (c == EOF && !bytes)
            return ENDED;
        if (bytes > CHARACTERS * TOUCH_TAXELS)
            return REFUSED;
        int blank = c == ' ' || c == '\t', ended = c == '\n' || c == EOF;
        if (length && (blank || ended || c == ',')) {
            char *end;
            word[length] = 0;
            frame[count++] = strtof(word, &end);
            if (*end)
                return REFUSED;
            length = gap = 0;
        }
        if (ended)
            return !count && !gap ? BLANK : count == TOUCH_TAXELS && gap != ',' ? FRAME : REFUSED;
        if (blank) {
            gap = gap || !count ? gap : ' ';
        } else if (c == ',') {
            if (!count || gap == ',')
                return REFUSED;
            gap = ',';
        } else {
            if (!length && count) {
                if (count == TOUCH_TAXELS || (count > 1 && gap != between))
                    return REFUSED;
                between = gap;
            }
            if (length == CHARACTERS || !c || !strchr("0123456789+-.eE", c))
                return REFUSED;
            word[length++] = (char)c;
        }
    }
}

/* A class name as a cell of a table. */
static const char *cell(const char *name)
{
    static char quoted[512];
    size_t at = 0;
    if (!strpbrk(name, ",\"\r\n"))
        return name;
    quoted[at++] = '"';
    for (; *name && at < sizeof quoted - 3; name++) {
        if (*name == '"')
            quoted[at++] = '"';
        quoted[at++] = *name;
    }
    quoted[at++] = '"';
    quoted[at] = 0;
    return quoted;
}

static int decided(int capture, int seen, int *settled)
{
    float proba[TOUCH_CLASSES], how = 0;
    int label = touch_label(&state, proba, &how);
    if (label < 0)
        return label;
#if TOUCH_STOPPING
    *settled = *settled || how >= TOUCH_THRESHOLD;
    const char *word = *settled ? "yes" : "no";
#else
    const char *word = "-";
    (void)settled;
#endif
    printf("%d,%.0f,%s,%.3f,%s\n", capture, 1000.0 / TOUCH_RATE_HZ * seen, cell(touch_name(label)), (double)proba[label],
           word);
    fflush(stdout);
    return 0;
}

static int refused(int number)
{
    fprintf(stderr, "line %d: send %d decimal numbers, all with commas or all with blanks between them\n", number,
            TOUCH_TAXELS);
    return 2;
}

#if TOUCH_WATCH
/* Lines until the input ends; blank ones mean nothing. */
static int watched(void)
{
    static const char *const words[] = {"", "reported", "changed", "ended"};
    touch_event_t event;
    double seen = 0;
    touch_watch_init(&watch);
    printf("ms,news,label,confidence\n");
    for (int number = 1;; number++) {
        int kind = read_line();
        if (kind == ENDED)
            return 0;
        if (kind == REFUSED)
            return refused(number);
        if (kind == BLANK)
            continue;
        int news = touch_watch(&watch, frame, &event);
        if (news < 0) {
            fprintf(stderr, "line %d: out of range\n", number);
            return 2;
        }
        seen++;
        if (news) {
            const char *label = event.label == TOUCH_UNKNOWN ? "unknown" : cell(touch_name(event.label));
            printf("%.0f,%s,%s,%.3f\n", 1000.0 / TOUCH_RATE_HZ * seen, words[news], label, (double)event.confidence);
            fflush(stdout);
        }
    }
}
#endif

int main(int count, char **words)
{
#if TOUCH_WATCH
    if (count == 2 && !strcmp(words[1], "-w"))
        return watched();
#endif
    if (count > 1) {
        fprintf(stderr, "%s: %s\n", words[1], TOUCH_WATCH ? "give -w or nothing" : "give nothing");
        return 2;
    }
    int capture = 1, seen = 0, at_last = 0, number = 0, settled = 0, unlike = 0;
    touch_look_t look;
    const double per_hop = HOP_MS * TOUCH_RATE_HZ / 1000;
    touch_init(&state);
    touch_look_init(&look);
    printf("capture,ms,label,confidence,settled\n");
    for (;;) {
        int kind = read_line();
        if (kind == ENDED)
            break;
        number++;
        if (kind == FRAME) {
            int code = touch_push(&state, frame);
            if (code < 0) {
                fprintf(stderr, "line %d: %s\n", number, code == TOUCH_LONG ? "the capture is too long" : "out of range");
                return 2;
            }
            touch_look(&look, frame);
            seen++;
            if ((int)((seen + 1e-6) / per_hop) > (int)((seen - 1 + 1e-6) / per_hop)) {
                decided(capture, seen, &settled);
                at_last = seen;
            }
        } else if (kind == REFUSED) {
            return refused(number);
        } else if (seen) {
            if (at_last < seen)
                decided(capture, seen, &settled);
            unlike += touch_unlike(&look);
            touch_init(&state);
            touch_look_init(&look);
            capture++;
            seen = at_last = settled = 0;
        }
    }
    if (at_last < seen)
        decided(capture, seen, &settled);
    if (seen)
        unlike += touch_unlike(&look);
    if (unlike)
        fprintf(stderr, "%d of %d captures look unlike all training captures\n", unlike, capture - !seen);
    return 0;
}
