"""The stop button in the browser: what every page with an element of class ``mrd-stop`` needs, the login included.

A stop is a request of its own, sent at the press and not at the release: it needs no websocket, which may be connecting
again, no session, which may have ended, and waits for nothing else that the page asks for.
"""

from mrd_dashboard.guard import STOP

HEAD = f"""
<style>
  #mrd-said {{
    position: fixed; top: 96px; right: 16px; z-index: 9000; padding: 8px 16px; border-radius: 4px;
    color: white; font-weight: 500; pointer-events: none;
  }}
  @media (max-width: 767px) {{ #mrd-said {{ top: 150px; }} }}
</style>
<script>
  function mrdSay(text, colour) {{
    const say = document.getElementById('mrd-said');
    say.textContent = text;
    say.style.background = colour;
    say.hidden = false;
    clearTimeout(window.mrdSilence);
    window.mrdSilence = setTimeout(() => {{ say.hidden = true; }}, 10000);
  }}
  function mrdReleased() {{
    // Only what the release makes untrue: that a stop was not sent stays.
    const say = document.getElementById('mrd-said');
    if (say.textContent === 'stop sent') say.hidden = true;
  }}
  async function mrdStop() {{
    mrdSay('stop requested', '#b45309');
    let why = 'the server of the page does not answer';
    try {{
      const answer = await fetch('{STOP}', {{method: 'POST', keepalive: true, signal: AbortSignal.timeout(5000)}});
      if (answer.ok) {{
        mrdSay('stop sent', '#b45309');
        return;
      }}
      why = await answer.text();
    }} catch (error) {{ /* said below */ }}
    mrdSay(`STOP WAS NOT SENT: ${{why}}. Press the hard-wired button.`, '#b91c1c');
  }}
  addEventListener('pointerdown', event => {{
    if (event.button === 0 && event.target.closest('.mrd-stop')) mrdStop();
  }}, true);
  // The keyboard presses a button without a pointer.
  addEventListener('click', event => {{
    if (event.detail === 0 && event.target.closest('.mrd-stop')) mrdStop();
  }}, true);
</script>
"""
"""Part of the head of such a page."""
BODY = '<div id="mrd-said" role="alert" hidden></div>'
"""Part of its body: where it is said what came of a stop."""
