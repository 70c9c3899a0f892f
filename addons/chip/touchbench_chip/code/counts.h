
/* Frames since touch_watch_init, of them those of refused decisions, a hop or tick each, and saturated ones; modulo
   2^32. */
typedef struct {
    uint32_t frames, refused, saturated;
} touch_counts_t;

