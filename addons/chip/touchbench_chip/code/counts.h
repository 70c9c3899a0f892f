
#define TOUCH_REASONS 9 /* bits of touch_status */

/* Since touch_watch_init, modulo 2^32: frames taken, frames that touch_missed was told of, frames with readings below 0
   that were taken for 0; and for each bit of touch_status, frames after which it was set. Refused frames have a bit,
   and are not among those taken. */
typedef struct {
    uint32_t frames, missed, clamped, reasons[TOUCH_REASONS];
} touch_counts_t;

/* What touch_status is found from: the last frame, which taxels changed in a block of touches, sums over a tick, over
   ticks of background and over touches, and the least of all ticks. */
typedef struct {
    float last[$TAXELS], step, pace, slow_pace, tick[$QUIETS], quiet[$QUIETS], calm[$CALMS], touched[$TOUCHEDS];
    touch_look_t look;
    uint32_t at_largest;
    uint8_t moved[($TAXELS + 7) / 8];
    int repeated, pace_frames, tick_frames, quiet_ticks, calm_ticks, touches, since, follows, has_pace, is_lasting, is_new;
    unsigned quiet_status, calm_status, touch_status;
} touch_health_t;

