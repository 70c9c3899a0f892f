/* The mean pressure above a slow baseline of each taxel, two ticks in a row. */

/* A touch is reported at the second tick above a level, and is over below a share of it. */
static sign_t sensed(touch_watch_t *w, const float *tick)
{
    sign_t sign = {0, 0, 0, 0};
    float excess = 0;
    for (int i = 0; i < TAXELS; i++) {
        if (!w->felt)
            w->baseline[i] = tick[i];
        float above = tick[i] - w->baseline[i];
        w->baseline[i] += (above > 0 ? UP : DOWN) * above;
        excess += fmaxf(above, 0);
    }
    w->felt = 1;
    excess = excess / TAXELS / UNIT;
    w->since = excess > (w->is_known ? ENDS * w->level : w->level) ? w->since + 1 : 0;
    sign.report = w->since == 2 && !w->is_known;
    w->is_known = w->since && (w->is_known || sign.report);
    sign.since = sign.lasts = w->since;
    sign.sure = excess > 0 && excess >= w->level;
    return sign;
}
