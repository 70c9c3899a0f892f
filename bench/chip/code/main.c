/* Frames from standard input, a line each, a blank line ends a capture; a line per decision, as bench stream source=-. */

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "touch.h"

#ifndef HOP_MS
#define HOP_MS 125.0
#endif

static touch_t state;
static char line[TOUCH_TAXELS * 33 + 2];

/* Values of a line; 0 for a blank one, -1 for one that is no frame. */
static int parsed(float *frame)
{
    char *at = line;
    int count = 0;
    while (*at == ' ' || *at == '\t' || *at == '\r' || *at == '\n')
        at++;
    if (!*at)
        return 0;
    while (count < TOUCH_TAXELS) {
        char *end;
        frame[count++] = strtof(at, &end);
        if (end == at)
            return -1;
        at = end;
        while (*at == ' ' || *at == '\t' || *at == '\r' || *at == '\n')
            at++;
        if (*at == ',' && count < TOUCH_TAXELS)
            at++;
    }
    return *at ? -1 : 1;
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
    *settled = *settled || how >= TOUCH_THRESHOLD;
    printf("%d,%.0f,%s,%.3f,%s\n", capture, 1000.0 / TOUCH_RATE_HZ * seen, cell(touch_name(label)), (double)proba[label],
           TOUCH_STOPPING ? (*settled ? "yes" : "no") : "-");
    fflush(stdout);
    return 0;
}

int main(void)
{
    static float frame[TOUCH_TAXELS];
    int capture = 1, seen = 0, at_last = 0, number = 0, settled = 0;
    const double per_hop = HOP_MS * TOUCH_RATE_HZ / 1000;
    touch_init(&state);
    printf("capture,ms,label,confidence,settled\n");
    while (fgets(line, sizeof line, stdin)) {
        int kind = parsed(frame);
        number++;
        if (kind > 0) {
            int code = touch_push(&state, frame);
            if (code < 0) {
                fprintf(stderr, "line %d: %s\n", number, code == TOUCH_LONG ? "the capture is too long" : "out of range");
                return 2;
            }
            seen++;
            if ((int)((seen + 1e-6) / per_hop) > (int)((seen - 1 + 1e-6) / per_hop)) {
                decided(capture, seen, &settled);
                at_last = seen;
            }
        } else if (kind < 0) {
            fprintf(stderr, "line %d: send %d numbers\n", number, TOUCH_TAXELS);
            return 2;
        } else if (seen) {
            if (at_last < seen)
                decided(capture, seen, &settled);
            touch_init(&state);
            capture++;
            seen = at_last = settled = 0;
        }
    }
    if (at_last < seen)
        decided(capture, seen, &settled);
    return 0;
}
